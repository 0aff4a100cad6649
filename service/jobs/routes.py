"""Submitting, showing, listing, stopping, removing and repeating jobs."""

from __future__ import annotations

import time
from enum import StrEnum
from typing import Annotated, Any

from anyio import CapacityLimiter, to_thread
from fastapi import APIRouter, Header, Path, Query, Request, Response

from mpf_core.options import options_schema
from service.access.caller import Caller
from service.access.dependency import CallerDep
from service.jobs.commands import Filter, visible
from service.jobs.model import Job, JobState
from service.jobs.schemas import JobListOut, JobOut, RetryIn, cursor_from, job_out, place_from
from service.problems import catalogue
from service.responses import ACCEPTED, problems
from service.state import State, StateDep
from service.uploads.receive import reference_in

router = APIRouter(tags=["jobs"])

JobId = Annotated[str, Path(description="As POST /jobs gave it.")]

IdempotencyKey = Annotated[
    str,
    Header(
        max_length=255,
        description="The same key with the same request answers the same job, for 24 hours.",
    ),
]


class Keep(StrEnum):
    """What a cancelled job leaves behind."""

    RESULT = "result"


_FOUND = problems("job.not_found", "job.expired", "request.invalid")

# Checking and syncing an input takes long; polls must not wait for these threads.
_SUBMISSIONS = CapacityLimiter(8)

POLL_SECONDS = "2"
"""What Retry-After tells a client that polls."""

_INPUT_CODES = tuple(code for code, kind in catalogue().items() if kind.status in (413, 422))

_WEBHOOK: dict[str, Any] = {
    "type": "object",
    "required": ["url", "secret"],
    "properties": {
        "url": {"type": "string", "format": "uri"},
        "secret": {"type": "string", "pattern": "^whsec_"},
        "events": {"type": "array", "items": {"enum": list(JobState)}},
    },
}

_UPLOAD_BODY: dict[str, Any] = {
    "parameters": [
        {
            "name": name,
            "in": "query",
            "required": False,
            "schema": {"type": "string"},
            "description": f"With a bare body: {about}.",
        }
        for name, about in (
            ("name", "the file's name"),
            ("options", "as in the form, JSON"),
            ("label", "a word"),
            ("webhook", "as in the form, JSON"),
        )
    ],
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
                        "label": {"type": "string", "maxLength": 200},
                        "webhook": _WEBHOOK,
                    },
                },
                "encoding": {"options": {"contentType": "application/json"}},
            },
            "application/octet-stream": {"schema": {"type": "string"}},
            "application/json": {
                "schema": {
                    "type": "object",
                    "required": ["upload"],
                    "additionalProperties": False,
                    "properties": {
                        "upload": {
                            "type": "string",
                            "description": "A complete upload, as POST /uploads gave it.",
                        },
                        "options": options_schema(),
                        "label": {"type": "string", "maxLength": 200},
                        "webhook": _WEBHOOK,
                    },
                }
            },
        },
    },
}


@router.post(
    "/jobs",
    status_code=202,
    openapi_extra=_UPLOAD_BODY,
    responses=problems(
        "request.malformed",
        "request.media_type",
        "upload.not_found",
        "upload.incomplete",
        *_INPUT_CODES,
        "quota.jobs",
        "queue.full",
        "storage.full",
        "idempotency.conflict",
    )
    | ACCEPTED,
)
async def submit(
    request: Request,
    response: Response,
    caller: CallerDep,
    state: StateDep,
    idempotency_key: IdempotencyKey = "",
) -> JobOut:
    """Take a cloud in and queue its reconstruction."""
    reference = await reference_in(request)
    if reference is not None:
        job = await to_thread.run_sync(
            state.intake.submit_upload, caller, reference, idempotency_key, limiter=_SUBMISSIONS
        )
    else:
        submission = await state.receiver.submission(request)
        job = await to_thread.run_sync(
            state.intake.submit, caller, submission, idempotency_key, limiter=_SUBMISSIONS
        )
    return await to_thread.run_sync(accepted, state, job, response)


@router.get("/jobs", responses=problems("request.invalid"))
def list_jobs(
    caller: CallerDep,
    state: StateDep,
    states: Annotated[list[JobState], Query(alias="state", description="Only these.")] = [],  # noqa: B006
    label: Annotated[str | None, Query(description="Only jobs with this label.")] = None,
    cursor: Annotated[str | None, Query(description="`next` of the page before.")] = None,
    limit: Annotated[int, Query(ge=1, le=200)] = 50,
) -> JobListOut:
    """The caller's jobs, newest first."""
    wanted = Filter(frozenset(states or JobState), label)
    after = place_from(cursor) if cursor is not None else None
    page = state.jobs.page(caller, wanted, after, limit)
    state.estimates.refresh()
    shown = [_shown(state, job, state.jobs.position(job)) for job in page.jobs]
    return JobListOut(jobs=shown, next=cursor_from(page.next))


@router.get("/jobs/{job_id}", responses=_FOUND)
async def show(
    job_id: JobId,
    response: Response,
    caller: CallerDep,
    state: StateDep,
    wait: Annotated[
        float, Query(ge=0, le=60, description="Answer when the state changes, or after this, s.")
    ] = 0.0,
) -> JobOut:
    """The job as it stands, or as soon as its state is another."""
    job, position = await _look(state, caller, job_id)
    if wait and not job.ended:
        job, position = await _next_state(state, caller, job, wait)
    if not job.ended:
        response.headers["Retry-After"] = POLL_SECONDS
    if job.state is JobState.QUEUED and state.estimates.stale():
        await to_thread.run_sync(state.estimates.refresh)
    return _shown(state, job, position)


@router.delete("/jobs/{job_id}", status_code=204, responses=problems("job.not_found"))
def delete(job_id: JobId, caller: CallerDep, state: StateDep) -> None:
    """Remove the job and all its files; a running one is stopped."""
    state.jobs.delete(caller, job_id)


@router.post("/jobs/{job_id}/cancel", status_code=202, responses=_FOUND | ACCEPTED)
def cancel(
    job_id: JobId,
    response: Response,
    caller: CallerDep,
    state: StateDep,
    keep: Annotated[Keep | None, Query(description="`result`: the surface so far.")] = None,
) -> JobOut:
    """Ask the job to stop; one that has ended stays as it is."""
    job = state.jobs.cancel(caller, job_id, keep=keep is Keep.RESULT)
    return accepted(state, job, response)


@router.post(
    "/jobs/{job_id}/retry",
    status_code=202,
    responses=problems(
        "job.not_found",
        "job.expired",
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
def retry(
    job_id: JobId,
    response: Response,
    caller: CallerDep,
    state: StateDep,
    changes: RetryIn | None = None,
    idempotency_key: IdempotencyKey = "",
) -> JobOut:
    """A new job on the same input, with some options changed."""
    wanted = changes or RetryIn()
    job = state.jobs.retry(caller, job_id, wanted.options, wanted.label, idempotency_key)
    return accepted(state, job, response)


async def _look(state: State, caller: Caller, job_id: str) -> tuple[Job, int | None]:
    found, position = await state.polls.look(job_id)
    return visible(found, caller, job_id), position


async def _next_state(
    state: State, caller: Caller, before: Job, seconds: float
) -> tuple[Job, int | None]:
    deadline = time.monotonic() + seconds
    with state.hub.watching(before.id) as watcher:
        # Read after the watch has begun, so that no change falls between the two.
        job, position = await _look(state, caller, before.id)
        while job.state is before.state and (left := deadline - time.monotonic()) > 0:
            if await watcher.wait(left) and watcher.state != before.state:
                job, position = await _look(state, caller, before.id)
        return job, position


def accepted(state: State, job: Job, response: Response) -> JobOut:
    """The job as the answer to whoever made or changed it, with where to look for it."""
    response.headers["Location"] = f"/jobs/{job.id}"
    response.headers["Retry-After"] = POLL_SECONDS
    state.estimates.refresh()
    return _shown(state, job, state.jobs.position(job))


def _shown(state: State, job: Job, position: int | None) -> JobOut:
    return job_out(job, position, state.estimates.eta(job, position))
