"""The files of a job's result."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

from fastapi import APIRouter, Path
from fastapi.responses import FileResponse

from service.access.caller import Caller
from service.access.dependency import CallerDep
from service.jobs.routes import JobId
from service.problems import Problem
from service.responses import problems
from service.state import State, StateDep

router = APIRouter(tags=["artefacts"])

_PROBLEMS = problems(
    "job.not_found", "job.expired", "artifact.not_found", "job.not_ready", "job.no_result"
)


class Axis(StrEnum):
    """The axis that a slice is perpendicular to."""

    X = "x"
    Y = "y"
    Z = "z"


class Ply(FileResponse):
    """PLY has no registered type."""

    media_type = "application/octet-stream"


class Glb(FileResponse):
    """Binary glTF."""

    media_type = "model/gltf-binary"


class Json(FileResponse):
    """A JSON document."""

    media_type = "application/json"


class Png(FileResponse):
    """A picture."""

    media_type = "image/png"


BY_SUFFIX: dict[str, type[FileResponse]] = {".glb": Glb, ".ply": Ply, ".json": Json, ".png": Png}


@router.get("/jobs/{job_id}/mesh.glb", response_class=Glb, responses=_PROBLEMS)
def mesh_glb(job_id: JobId, caller: CallerDep, state: StateDep) -> FileResponse:
    """The mesh as binary glTF."""
    return file_response(state, caller, job_id, "mesh.glb")


@router.get("/jobs/{job_id}/mesh.ply", response_class=Ply, responses=_PROBLEMS)
def mesh_ply(job_id: JobId, caller: CallerDep, state: StateDep) -> FileResponse:
    """The mesh as binary PLY, in the input's coordinates."""
    return file_response(state, caller, job_id, "mesh.ply")


@router.get("/jobs/{job_id}/report.json", response_class=Json, responses=_PROBLEMS)
def report(job_id: JobId, caller: CallerDep, state: StateDep) -> FileResponse:
    """Options, timings, losses, distances, topology."""
    return file_response(state, caller, job_id, "report.json")


@router.get(
    "/jobs/{job_id}/slices/{axis}/{index}.png",
    response_class=Png,
    responses=_PROBLEMS | problems("request.invalid"),
)
def slice_png(
    job_id: JobId,
    axis: Axis,
    index: Annotated[int, Path(ge=0, le=9999, description="From 0, along the axis.")],
    caller: CallerDep,
    state: StateDep,
) -> FileResponse:
    """One φ slice as a picture."""
    return file_response(state, caller, job_id, f"slices/{axis}/{index}.png")


def file_response(state: State, caller: Caller, job_id: str, name: str) -> FileResponse:
    """A published file of the job, with what caches need to know."""
    job = state.jobs.artifact_of(caller, job_id, name)
    try:
        path = state.artifacts.result(job.id, job.result_attempt, name)
    except FileNotFoundError as error:
        raise Problem("artifact.not_found", f"job {job_id} has lost its {name}") from error
    # A published file never changes, so clients may keep it.
    return BY_SUFFIX.get(path.suffix, Ply)(
        path,
        headers={"Cache-Control": "private, max-age=31536000, immutable"},
        filename=f"{job_id[:8]}-{name.replace('/', '-')}",
        content_disposition_type="inline",
    )
