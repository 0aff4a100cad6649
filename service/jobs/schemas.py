"""The job as HTTP shows it."""

from __future__ import annotations

from base64 import urlsafe_b64decode, urlsafe_b64encode
from dataclasses import asdict
from datetime import UTC, datetime
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from mpf_core.options import options_schema
from service.jobs.index_store import Place
from service.jobs.model import Input, Job, JobProgress, JobState
from service.problems import Problem, catalogue

_CODES: dict[str, Any] = {
    "enum": sorted(catalogue()),
    "x-enum-descriptions": [catalogue()[code].title for code in sorted(catalogue())],
}


class ProblemOut(BaseModel):
    """RFC 9457 problem details; `code` is stable, the rest is for people."""

    model_config = ConfigDict(title="Problem", json_schema_serialization_defaults_required=True)

    type: str
    title: str
    status: int
    detail: str
    code: str = Field(json_schema_extra=_CODES)
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
    points_per_second: float | None = Field(
        default=None, description="Samples at which the fit evaluates its field."
    )
    seconds: float = Field(description="Since this attempt started, s.")
    eta: float | None = Field(default=None, description="Expected time to the end, s.")


class TilesOut(BaseModel):
    """Parts of a cloud that is too large for one fit, each fitted by any worker that is free."""

    model_config = ConfigDict(title="Tiles")

    done: int = Field(description="Fitted.")
    running: int = Field(description="Being fitted.")
    total: int


class InputOut(BaseModel):
    """What was uploaded."""

    model_config = ConfigDict(title="Input")

    name: str
    format: str
    bytes: int
    sha256: str
    points: int | None = Field(default=None, description="None while they are not counted.")


class ArtifactOut(BaseModel):
    """One file of the result."""

    model_config = ConfigDict(title="Artifact")

    href: str
    bytes: int
    sha256: str


class JobOut(BaseModel):
    """One job. Times are RFC 3339 in UTC."""

    model_config = ConfigDict(title="Job")

    id: str
    kind: str = Field(description="fit, or extraction: from the field of `parent`.")
    parent: str | None = Field(description="The job whose input or field this one uses.")
    label: str
    state: JobState
    attempt: int = Field(
        description="Grows when the job is handed back or its worker is lost, and once before its "
        "tiles are joined."
    )
    cancelling: bool = Field(description="It was asked to stop and has not stopped yet.")
    queue: str = Field(description="Where it waits, by its weight: extract, fit-small, fit-large.")
    queue_position: int | None = Field(
        description="Jobs before this one in its queue; None unless queued."
    )
    eta: float | None = Field(
        description="Seconds until it is done, by how long jobs took lately; None: not known."
    )
    progress: ProgressOut | None
    tiles: TilesOut | None = Field(
        description="How far the parts are; None where the cloud is fitted as a whole, and until "
        "it is split."
    )
    options: dict[str, Any]
    input: InputOut | None
    problem: ProblemOut | None = Field(description="Why it failed or was cancelled.")
    created_at: datetime
    updated_at: datetime
    queued_at: datetime = Field(description="Of this attempt.")
    started_at: datetime | None = Field(description="Of the latest attempt that has started.")
    finished_at: datetime | None
    expires_at: datetime = Field(
        description="When its files are removed, if it has ended by then; of an expired job, when "
        "that was."
    )
    artifacts: dict[str, ArtifactOut] = Field(description="The files of the result by name.")
    links: dict[str, str]


def job_out(job: Job, position: int | None = None, eta: float | None = None) -> JobOut:
    """The record as its owner sees it."""
    return JobOut(
        id=job.id,
        kind=job.kind,
        parent=job.parent or None,
        label=job.label,
        state=job.state,
        attempt=job.attempt,
        cancelling=bool(job.cancel) and not job.ended,
        queue=job.queue,
        queue_position=position,
        eta=None if eta is None else round(eta, 1),
        progress=_progress_out(job.progress),
        tiles=TilesOut(**asdict(job.tiles)) if job.tiles else None,
        options=dict(job.options),
        input=_input_out(job.input),
        problem=ProblemOut(**job.problem) if job.problem else None,
        created_at=_time(job.created_at),
        updated_at=_time(job.updated_at),
        queued_at=_time(job.queued_at),
        started_at=_time(job.started_at) if job.started_at else None,
        finished_at=_time(job.finished_at) if job.finished_at else None,
        expires_at=_time(job.expires_at),
        artifacts={
            name: ArtifactOut(href=f"/jobs/{job.id}/{name}", bytes=file.bytes, sha256=file.sha256)
            for name, file in job.artifacts.items()
        },
        links={"self": f"/jobs/{job.id}"}
        | {
            name: f"/jobs/{job.id}/{name}"
            for name in ("input", "cancel", "retry", "extractions", "events")
        }
        | ({"preview": f"/jobs/{job.id}/preview.glb"} if job.shown else {}),
    )


class JobListOut(BaseModel):
    """A page of jobs, newest first."""

    model_config = ConfigDict(title="JobList")

    jobs: list[JobOut]
    next: str | None = Field(description="Cursor of the next page; None on the last one.")


class RetryIn(BaseModel):
    """What is different from the job that is tried again."""

    model_config = ConfigDict(title="Retry", extra="forbid")

    options: dict[str, Any] = Field(default_factory=dict, json_schema_extra=options_schema())
    label: str = Field(default="", max_length=200)


def cursor_from(place: Place | None) -> str | None:
    """A place in a list as a client carries it."""
    if place is None:
        return None
    return urlsafe_b64encode(f"{place.created_at}.{place.job_id}".encode()).decode().rstrip("=")


def place_from(cursor: str) -> Place:
    """The place that a cursor stands for; raises Problem if it is none of ours."""
    try:
        text = urlsafe_b64decode(cursor + "=" * (-len(cursor) % 4)).decode()
        created_at, _, job_id = text.partition(".")
        return Place(int(created_at), job_id)
    except ValueError as error:
        raise Problem("request.invalid", "the cursor is none of ours", where="cursor") from error


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
        points_per_second=progress.points_per_second,
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
