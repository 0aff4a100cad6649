"""The files of a job's result."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

from fastapi import APIRouter, Path
from fastapi.responses import FileResponse

from service.jobs.routes import JobId
from service.problems import Problem
from service.responses import problems
from service.state import State, StateDep

router = APIRouter(tags=["artefacts"])

MEDIA_TYPES = {
    ".glb": "model/gltf-binary",
    ".ply": "application/octet-stream",
    ".json": "application/json",
    ".png": "image/png",
}

_PROBLEMS = problems(
    "job.not_found", "artifact.not_found", "job.not_ready", "job.no_result", "request.invalid"
)


class Axis(StrEnum):
    """The axis that a slice is perpendicular to."""

    X = "x"
    Y = "y"
    Z = "z"


class File(FileResponse):
    """A published file; it never changes, so clients may keep it."""

    media_type = "application/octet-stream"


@router.get("/jobs/{job_id}/mesh.glb", response_class=File, responses=_PROBLEMS)
def mesh_glb(job_id: JobId, state: StateDep) -> File:
    """The mesh as binary glTF."""
    return _file(state, job_id, "mesh.glb")


@router.get("/jobs/{job_id}/mesh.ply", response_class=File, responses=_PROBLEMS)
def mesh_ply(job_id: JobId, state: StateDep) -> File:
    """The mesh as binary PLY, in the input's coordinates."""
    return _file(state, job_id, "mesh.ply")


@router.get("/jobs/{job_id}/report.json", response_class=File, responses=_PROBLEMS)
def report(job_id: JobId, state: StateDep) -> File:
    """Options, timings, losses, distances, topology."""
    return _file(state, job_id, "report.json")


@router.get("/jobs/{job_id}/slices/{axis}/{index}.png", response_class=File, responses=_PROBLEMS)
def slice_png(
    job_id: JobId,
    axis: Axis,
    index: Annotated[int, Path(ge=0, le=9999, description="From 0, along the axis.")],
    state: StateDep,
) -> File:
    """One φ slice as a picture."""
    return _file(state, job_id, f"slices/{axis}/{index}.png")


def _file(state: State, job_id: str, name: str) -> File:
    job, name = state.jobs.artifact_of(job_id, name)
    try:
        path = state.artifacts.result(job.id, job.result_attempt, name)
    except FileNotFoundError as error:
        raise Problem("artifact.not_found", f"job {job_id} has lost its {name}") from error
    return File(
        path,
        media_type=MEDIA_TYPES.get(path.suffix, File.media_type),
        headers={"Cache-Control": "private, max-age=31536000, immutable"},
        filename=f"{job_id[:8]}-{name.replace('/', '-')}",
        content_disposition_type="inline",
    )
