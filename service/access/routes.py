"""Share links: reading one job without a key."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated

from fastapi import APIRouter, Path, Request, Response
from pydantic import BaseModel, ConfigDict, Field

from service.access.caller import Caller
from service.access.dependency import CallerDep
from service.artifacts.routes import ELSEWHERE, file_response, preview_response
from service.jobs.model import Job
from service.jobs.routes import JobId
from service.jobs.schemas import JobOut, job_out
from service.problems import Problem
from service.responses import links, problems
from service.state import State, StateDep

router = APIRouter(tags=["shares"])

Token = Annotated[str, Path(description="Of the share link.", max_length=100)]


class Anything(Response):
    """Whichever file was asked for."""

    media_type = "*/*"


class ShareIn(BaseModel):
    """For how long a job is shared."""

    model_config = ConfigDict(title="ShareRequest", extra="forbid")

    seconds: int = Field(default=7 * 86_400, ge=60, le=365 * 86_400, description="s")


class ShareOut(BaseModel):
    """A share; `href` holds the token and is shown only once."""

    model_config = ConfigDict(title="Share")

    id: str
    href: str
    expires_at: datetime


@router.post(
    "/jobs/{job_id}/shares",
    status_code=201,
    responses=problems(
        "job.not_found", "job.expired", "access.denied", "request.malformed", "request.invalid"
    )
    | {
        201: {
            "links": links(
                {"job_id": "$request.path.job_id", "share_id": "$response.body#/id"}, "unshare"
            )
        }
    },
)
def share(
    job_id: JobId, caller: CallerDep, state: StateDep, wanted: ShareIn | None = None
) -> ShareOut:
    """A link with which anybody may read this job and its files."""
    state.jobs.get(caller, job_id)
    made, token = state.shares.create(job_id, (wanted or ShareIn()).seconds)
    expires_at = datetime.fromtimestamp(made.expires_at, UTC)
    return ShareOut(id=made.id, href=f"/shared/{token}", expires_at=expires_at)


@router.delete(
    "/jobs/{job_id}/shares/{share_id}",
    status_code=204,
    responses=problems("job.not_found", "job.expired", "share.not_found", "access.denied"),
)
def unshare(job_id: JobId, share_id: str, caller: CallerDep, state: StateDep) -> None:
    """End a share link."""
    state.jobs.get(caller, job_id)
    if not state.shares.revoke(job_id, share_id):
        raise Problem("share.not_found", f"job {job_id} has no share {share_id}")


@router.get(
    "/shared/{token}", responses=problems("share.not_found", "job.expired", "request.invalid")
)
def shared_job(token: Token, state: StateDep) -> JobOut:
    """The job that was shared."""
    return job_out(_shared(state, token))


@router.get(
    "/shared/{token}/{name:path}",
    response_class=Anything,
    responses=problems(
        "share.not_found",
        "artifact.not_found",
        "job.not_ready",
        "job.no_result",
        "job.expired",
        "request.invalid",
        "request.range",
    )
    | ELSEWHERE,
)
def shared_file(token: Token, name: str, request: Request, state: StateDep) -> Response:
    """A file of the job that was shared."""
    job = _shared(state, token)
    if name == "preview.glb":
        return preview_response(state, Caller(job.owner), job.id, request)
    return file_response(state, Caller(job.owner), job.id, name, request)


def _shared(state: State, token: str) -> Job:
    job_id = state.shares.find(token)
    job = state.store.get(job_id) if job_id else None
    if job is None:
        raise Problem("share.not_found", "this share has ended, or never was")
    return state.jobs.get(Caller(job.owner), job.id)
