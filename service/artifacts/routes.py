"""The files of a job's result."""

from __future__ import annotations

import hashlib
from base64 import b64encode
from enum import StrEnum
from pathlib import PurePath
from typing import Annotated, Any

from fastapi import APIRouter, Path, Request, Response
from fastapi.responses import FileResponse, StreamingResponse
from starlette.datastructures import Headers
from starlette.types import Message, Receive, Scope, Send

from service.access.caller import Caller
from service.access.dependency import CallerDep
from service.artifacts.archive import zip_of
from service.artifacts.passing import linked, passed, wants_link
from service.jobs.routes import JobId
from service.problem_handlers import respond
from service.problems import Problem
from service.responses import UNCHANGED, problems
from service.state import State, StateDep

router = APIRouter(tags=["artefacts"])

_PROBLEMS = problems(
    "job.not_found",
    "job.expired",
    "artifact.not_found",
    "job.not_ready",
    "job.no_result",
    "request.range",
)
_NO_RANGES = {status: told for status, told in _PROBLEMS.items() if status != 416}

ELSEWHERE: dict[int | str, dict[str, Any]] = {
    307: {
        "description": "The file at the object store, by a link that lapses; never sent to the "
        "scripts and pictures of a web page.",
        "headers": {"Location": {"schema": {"type": "string", "format": "uri"}}},
    }
}
_FILE = _PROBLEMS | ELSEWHERE


class Axis(StrEnum):
    """The axis that a slice is perpendicular to."""

    X = "x"
    Y = "y"
    Z = "z"


class Published(FileResponse):
    """A file; a bad Range is answered as a problem, like everything else."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        refused: list[Message] = []

        async def watched(message: Message) -> None:
            if message["type"] == "http.response.start" and message["status"] in (400, 416):
                refused.append(message)
            elif not refused:
                await send(message)

        await super().__call__(scope, receive, watched)
        if refused:
            size = Headers(raw=refused[0]["headers"]).get("content-range")
            problem = Problem("request.range", "the file has no such range", where="Range")
            headers = {"Content-Range": size} if size else {}
            await respond(problem, Request(scope), headers)(scope, receive, send)


class Ply(Published):
    """PLY has no registered type."""

    media_type = "application/octet-stream"


class Glb(Published):
    """Binary glTF."""

    media_type = "model/gltf-binary"


class Json(Published):
    """A JSON document."""

    media_type = "application/json"


class Png(Published):
    """A picture."""

    media_type = "image/png"


class Zip(StreamingResponse):
    """An archive of all."""

    media_type = "application/zip"


class Field(Published):
    """Safetensors has no registered type."""

    media_type = "application/octet-stream"


class FieldName(StrEnum):
    """What a slice shows."""

    PHI = "phi"
    R = "r"
    THETA = "theta"
    P = "P"


BY_SUFFIX: dict[str, type[Published]] = {
    ".glb": Glb,
    ".ply": Ply,
    ".json": Json,
    ".png": Png,
    ".safetensors": Field,
}

Index = Annotated[int, Path(ge=0, le=9999, description="From 0, along the axis.")]


@router.get(
    "/jobs/{job_id}/input",
    response_class=Ply,
    responses=problems("job.not_found", "job.expired", "artifact.not_found", "request.range"),
)
def input_file(job_id: JobId, request: Request, caller: CallerDep, state: StateDep) -> Response:
    """What was uploaded, byte by byte; of an extraction the field that it works on."""
    job, suffix, blob = state.jobs.input_of(caller, job_id)
    tag = f'"{job.input.sha256}"' if job.input else '""'
    headers = {"Cache-Control": "private, max-age=31536000, immutable", "ETag": tag}
    if tag in request.headers.get("if-none-match", ""):
        return Response(status_code=304, headers=headers)
    # Never inline: a browser must not make a page of what somebody has uploaded.
    headers["X-Content-Type-Options"] = "nosniff"
    name = f"{job_id[:8]}-input{suffix}"
    plain = "application/octet-stream"
    if blob.path is not None:
        return Ply(blob.path, headers=headers, filename=name, media_type=plain)
    # Nor by a link: the store would not say so.
    headers["Content-Disposition"] = f'attachment; filename="{name}"'
    return passed(blob, request, headers, plain)


@router.get("/jobs/{job_id}/mesh.glb", response_class=Glb, responses=_FILE)
def mesh_glb(job_id: JobId, request: Request, caller: CallerDep, state: StateDep) -> Response:
    """The mesh as binary glTF."""
    return file_response(state, caller, job_id, "mesh.glb", request)


@router.get("/jobs/{job_id}/mesh.ply", response_class=Ply, responses=_FILE)
def mesh_ply(job_id: JobId, request: Request, caller: CallerDep, state: StateDep) -> Response:
    """The mesh as binary PLY, in the input's coordinates."""
    return file_response(state, caller, job_id, "mesh.ply", request)


@router.get("/jobs/{job_id}/field.safetensors", response_class=Field, responses=_FILE)
def field(job_id: JobId, request: Request, caller: CallerDep, state: StateDep) -> Response:
    """The fitted field, with everything needed to use it."""
    return file_response(state, caller, job_id, "field.safetensors", request)


@router.get("/jobs/{job_id}/report.json", response_class=Json, responses=_FILE)
def report(job_id: JobId, request: Request, caller: CallerDep, state: StateDep) -> Response:
    """Options, timings, losses, distances, topology."""
    return file_response(state, caller, job_id, "report.json", request)


@router.get(
    "/jobs/{job_id}/slices/{axis}/{index}.png",
    response_class=Png,
    responses=_FILE | problems("request.invalid"),
)
def slice_png(
    job_id: JobId,
    axis: Axis,
    index: Index,
    request: Request,
    caller: CallerDep,
    state: StateDep,
) -> Response:
    """One φ slice of the stack as a picture."""
    return file_response(state, caller, job_id, f"slices/{axis}/{index}.png", request)


@router.get(
    "/jobs/{job_id}/preview.glb",
    response_class=Glb,
    responses=problems("job.not_found", "job.expired", "artifact.not_found", "job.not_ready")
    | UNCHANGED,
)
def preview_glb(job_id: JobId, request: Request, caller: CallerDep, state: StateDep) -> Response:
    """A coarse mesh of what the fit has come to; another one takes its place every few seconds."""
    return preview_response(state, caller, job_id, request)


@router.get(
    "/jobs/{job_id}/slices/{field}/{axis}/{index}.png",
    response_class=Png,
    responses=_FILE | problems("request.invalid"),
)
def cut_png(
    job_id: JobId,
    field: FieldName,
    axis: Axis,
    index: Index,
    request: Request,
    caller: CallerDep,
    state: StateDep,
) -> Response:
    """One slice that an extraction was asked for."""
    return file_response(state, caller, job_id, f"slices/{field}/{axis}/{index}.png", request)


@router.get("/jobs/{job_id}/result.zip", response_class=Zip, responses=_NO_RANGES)
def result_zip(job_id: JobId, caller: CallerDep, state: StateDep) -> Zip:
    """All files of the result in one archive."""
    job = state.jobs.result_of(caller, job_id)
    files = [
        (name, state.artifacts.result(job.id, job.result_attempt, name)) for name in job.artifacts
    ]
    name = f'attachment; filename="{job_id[:8]}.zip"'
    return Zip(zip_of(files), headers={"Content-Disposition": name, "Cache-Control": "private"})


def preview_response(state: State, caller: Caller, job_id: str, request: Request) -> Response:
    """The preview as it is now: read at once, since another one may take its place."""
    glb = state.jobs.preview_of(caller, job_id)
    tag = f'"{hashlib.sha256(glb).hexdigest()}"'
    headers = {"Cache-Control": "private, no-cache", "ETag": tag}
    if tag in request.headers.get("if-none-match", ""):
        return Response(status_code=304, headers=headers)
    return Response(glb, headers=headers, media_type=Glb.media_type)


def file_response(
    state: State, caller: Caller, job_id: str, name: str, request: Request
) -> Response:
    """A published file of the job, with what caches need to know."""
    job = state.jobs.artifact_of(caller, job_id, name)
    sha256 = job.artifacts[name].sha256
    tag = f'"{sha256}"'
    headers = {
        # A published file never changes, so clients may keep it.
        "Cache-Control": "private, max-age=31536000, immutable",
        "ETag": tag,
        "Repr-Digest": f"sha-256=:{b64encode(bytes.fromhex(sha256)).decode()}:",
    }
    if tag in request.headers.get("if-none-match", ""):
        return Response(status_code=304, headers=headers)
    try:
        blob = state.artifacts.result(job.id, job.result_attempt, name)
    except FileNotFoundError as error:
        raise Problem("artifact.not_found", f"job {job_id} has lost its {name}") from error
    kind = BY_SUFFIX.get(PurePath(name).suffix, Ply)
    saved_as = f"{job_id[:8]}-{name.replace('/', '-')}"
    if blob.path is not None:
        return kind(
            blob.path, headers=headers, filename=saved_as, content_disposition_type="inline"
        )
    link = blob.link() if wants_link(request) else None
    if link is not None:
        return linked(link, headers)
    headers["Content-Disposition"] = f'inline; filename="{saved_as}"'
    return passed(blob, request, headers, kind.media_type or Ply.media_type)
