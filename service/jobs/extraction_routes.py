"""Asking for a mesh or slices from the field of a job."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Response
from pydantic import BaseModel, ConfigDict, Field

from mpf_core.extraction_options import extraction_schema
from service.access.dependency import CallerDep
from service.jobs.extraction import extract
from service.jobs.routes import IdempotencyKey, JobId, accepted
from service.jobs.schemas import JobOut
from service.responses import ACCEPTED, problems
from service.state import StateDep

router = APIRouter(tags=["jobs"])


class ExtractionIn(BaseModel):
    """What to take from the field; options of the surface that are not named stay."""

    model_config = ConfigDict(title="Extraction", extra="forbid")

    options: dict[str, Any] = Field(default_factory=dict, json_schema_extra=extraction_schema())
    label: str = Field(default="", max_length=200)


@router.post(
    "/jobs/{job_id}/extractions",
    status_code=202,
    responses=problems(
        "job.not_found",
        "job.expired",
        "job.not_ready",
        "job.no_result",
        "artifact.not_found",
        "options.invalid",
        "request.malformed",
        "request.invalid",
        "idempotency.conflict",
        "quota.jobs",
        "queue.full",
        "storage.full",
    )
    | ACCEPTED,
)
def extraction(
    job_id: JobId,
    response: Response,
    caller: CallerDep,
    state: StateDep,
    wanted: ExtractionIn | None = None,
    idempotency_key: IdempotencyKey = "",
) -> JobOut:
    """A new job that takes a mesh or slices from the field of this one, without refitting."""
    asked = wanted or ExtractionIn()
    job = extract(
        state.jobs, state.artifacts, caller, job_id, asked.options, asked.label, idempotency_key
    )
    return accepted(state, job, response)
