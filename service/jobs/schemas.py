"""The job as HTTP shows it."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from service.jobs.model import Input, Job, JobProgress, JobState


class ProblemOut(BaseModel):
    """RFC 9457 problem details; `code` is stable, the rest is for people."""

    model_config = ConfigDict(title="Problem", json_schema_serialization_defaults_required=True)

    type: str
    title: str
    status: int
    detail: str
    code: str
    where: str | None = None
    advice: str | None = None
    instance: str | None = None


class ProgressOut(BaseModel):
    """The last report of a running job."""

    model_config = ConfigDict(title="Progress")

    stage: str
    fraction: float = Field(description="Of the whole job, 0 to 1.")
    iteration: int | None = None
    iterations: int | None = Field(default=None, description="The cap.")
    loss: float | None = None
    losses: dict[str, float] = Field(default_factory=dict, description="Unweighted terms.")
    seconds: float = Field(description="Since this attempt started, s.")
    eta: float | None = Field(default=None, description="Expected time to the end, s.")


class InputOut(BaseModel):
    """What was uploaded."""

    model_config = ConfigDict(title="Input")

    name: str
    format: str
    bytes: int
    sha256: str
    points: int | None = Field(default=None, description="None while they are not counted.")


class JobOut(BaseModel):
    """One job. Times are RFC 3339 in UTC."""

    model_config = ConfigDict(title="Job")

    id: str
    kind: str
    state: JobState
    attempt: int = Field(description="Grows when the job is handed back or its worker is lost.")
    cancelling: bool = Field(description="It was asked to stop and has not stopped yet.")
    queue_position: int | None = Field(description="Jobs before this one; None unless queued.")
    progress: ProgressOut | None
    options: dict[str, Any]
    input: InputOut | None
    problem: ProblemOut | None = Field(description="Why it failed or was cancelled.")
    created_at: datetime
    updated_at: datetime
    started_at: datetime | None
    finished_at: datetime | None
    artifacts: dict[str, str] = Field(description="Name → link of each file of the result.")
    links: dict[str, str]


def job_out(job: Job, position: int | None) -> JobOut:
    """The record as its owner sees it."""
    return JobOut(
        id=job.id,
        kind=job.kind,
        state=job.state,
        attempt=job.attempt,
        cancelling=bool(job.cancel) and not job.ended,
        queue_position=position,
        progress=_progress_out(job.progress),
        options=dict(job.options),
        input=_input_out(job.input),
        problem=ProblemOut(**job.problem) if job.problem else None,
        created_at=_time(job.created_at),
        updated_at=_time(job.updated_at),
        started_at=_time(job.started_at) if job.started_at else None,
        finished_at=_time(job.finished_at) if job.finished_at else None,
        artifacts={name: f"/jobs/{job.id}/{name}" for name in job.artifacts},
        links={"self": f"/jobs/{job.id}", "cancel": f"/jobs/{job.id}/cancel"},
    )


def _progress_out(progress: JobProgress | None) -> ProgressOut | None:
    if progress is None:
        return None
    return ProgressOut(
        stage=progress.stage,
        fraction=progress.fraction,
        iteration=progress.iteration,
        iterations=progress.iterations,
        loss=progress.loss,
        losses=dict(progress.losses),
        seconds=progress.seconds,
        eta=progress.eta,
    )


def _input_out(given: Input | None) -> InputOut | None:
    if given is None:
        return None
    return InputOut(name=given.name, format=given.format, bytes=given.bytes,
                    sha256=given.sha256, points=given.points)  # fmt: skip


def _time(milliseconds: int) -> datetime:
    return datetime.fromtimestamp(milliseconds / 1000, UTC)
