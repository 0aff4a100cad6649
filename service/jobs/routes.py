"""POST /jobs, GET /jobs/{id}, POST /jobs/{id}/cancel."""

from __future__ import annotations

from typing import Annotated, Any

from anyio import to_thread
from fastapi import APIRouter, Path, Request, Response

from mpf_core.options import options_schema
from service.jobs.schemas import JobOut, job_out
from service.problems import catalogue
from service.responses import problems
from service.state import State, StateDep

router = APIRouter(tags=["jobs"])

JobId = Annotated[str, Path(description="As POST /jobs gave it.")]

POLL_SECONDS = "2"
"""What Retry-After tells a client that polls."""

_INPUT_CODES = tuple(code for code, kind in catalogue().items() if kind.status in (413, 422))

_UPLOAD_BODY: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "content": {
            "multipart/form-data": {
                "schema": {
                    "type": "object",
                    "required": ["file"],
                    "properties": {
                        "file": {
                            "type": "string",
                            "contentMediaType": "application/octet-stream",
                            "description": "A point cloud, .ply or .xyz.",
                        },
                        "options": options_schema(),
                    },
                },
                "encoding": {"options": {"contentType": "application/json"}},
            }
        },
    }
}


@router.post(
    "/jobs",
    status_code=202,
    openapi_extra=_UPLOAD_BODY,
    responses=problems(
        "request.malformed", "request.media_type", *_INPUT_CODES, "queue.full", "storage.full"
    )
    | {
        202: {
            "headers": {
                "Location": {"schema": {"type": "string"}, "description": "Where the job is."},
                "Retry-After": {"schema": {"type": "integer"}, "description": "s"},
            }
        }
    },
)
async def submit(request: Request, response: Response, state: StateDep) -> JobOut:
    """Take a cloud in and queue its reconstruction."""
    submission = await state.receiver.form(request)
    job = await to_thread.run_sync(state.jobs.submit, submission)
    _point_at(response, job.id)
    return await to_thread.run_sync(_shown, state, job.id)


@router.get("/jobs/{job_id}", responses=problems("job.not_found"))
def show(job_id: JobId, response: Response, state: StateDep) -> JobOut:
    """The job as it stands."""
    shown = _shown(state, job_id)
    if shown.state in ("queued", "running"):
        response.headers["Retry-After"] = POLL_SECONDS
    return shown


@router.post(
    "/jobs/{job_id}/cancel",
    status_code=202,
    responses=problems("job.not_found"),
)
def cancel(job_id: JobId, response: Response, state: StateDep) -> JobOut:
    """Ask the job to stop; one that has ended stays as it is."""
    state.jobs.cancel(job_id)
    _point_at(response, job_id)
    return _shown(state, job_id)


def _point_at(response: Response, job_id: str) -> None:
    response.headers["Location"] = f"/jobs/{job_id}"
    response.headers["Retry-After"] = POLL_SECONDS


def _shown(state: State, job_id: str) -> JobOut:
    job = state.jobs.get(job_id)
    return job_out(job, state.jobs.position(job))
