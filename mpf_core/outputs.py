"""What a reconstruction leaves behind in a folder."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Protocol

import torch

from mpf_core.field.blendfile import save_field
from mpf_core.field.fitted import Fitted
from mpf_core.files import write_atomically
from mpf_core.options import Options
from mpf_core.parallel import workers
from mpf_core.surface.export import write_glb, write_ply
from mpf_core.surface.mesh import Mesh
from mpf_core.surface.slices import write_slices


class Result(Protocol):
    """A reconstruction, of one fit or of many."""

    @property
    def fitted(self) -> Fitted: ...
    @property
    def mesh(self) -> Mesh: ...
    @property
    def report(self) -> dict[str, Any]: ...


def write_result(result: Result, out: Path, options: Options) -> dict[str, Any]:
    """mesh.glb, mesh.ply, field.safetensors, slices/{axis}/{index}.png and report.json in the
    folder `out`, made where it is missing. Returns the report."""
    out.mkdir(parents=True, exist_ok=True)
    write_glb(result.mesh, out / "mesh.glb")
    write_ply(result.mesh, out / "mesh.ply")
    save_field(result.fitted, out / "field.safetensors")
    slices = write_stack(result.fitted, options.surface.slices, out, options.threads)
    report = result.report | {"slices": slices}
    write_report(report, out / "report.json")
    return report


def write_stack(
    fitted: Fitted, count: int, out: Path, threads: int | None = None
) -> list[dict[str, Any]]:
    """`count` φ slices along each axis, as slices/{axis}/{index}.png.

    Returns what the report tells of them: where they lie, in the input's units, and where the plot
    is in each picture.
    """
    evaluate = fitted.values("phi")
    with workers(threads or torch.get_num_threads()):
        written = write_slices(evaluate, fitted.similarity, fitted.box, count, out)
    return [s.cut.told(f"slices/{s.cut.axis}/{s.index}.png", "phi") for s in written]


def write_report(report: dict[str, Any], path: Path) -> None:
    """The report as indented JSON."""
    write_atomically(path, (json.dumps(report, indent=2, ensure_ascii=False) + "\n").encode())
