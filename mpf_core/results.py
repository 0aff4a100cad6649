"""From files to files: what a reconstruction leaves behind."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import torch

from mpf_core.cloud.reader import read_cloud
from mpf_core.field.artefact import save_field
from mpf_core.field.fitted import FittedField, field_of
from mpf_core.files import write_atomically
from mpf_core.options import Options
from mpf_core.parallel import workers
from mpf_core.pipeline import reconstruct_cloud
from mpf_core.progress import CancelCheck, Clock, PreviewCallback, ProgressCallback
from mpf_core.surface.export import write_glb, write_ply
from mpf_core.surface.slices import write_slices
from mpf_core.watch import Watch


def reconstruct_file(
    cloud_path: Path,
    out: Path,
    options: Options,
    *,
    progress: ProgressCallback | None = None,
    stop: CancelCheck | None = None,
    cancel: CancelCheck | None = None,
    checkpoint: Path | None = None,
    preview: PreviewCallback | None = None,
    clock: Clock = time.monotonic,
) -> dict[str, Any]:
    """Read a cloud and write mesh.glb, mesh.ply, field.safetensors, slices/{axis}/{index}.png and
    report.json.

    `stop` ends the fit and takes the surface that it has come to; `cancel` ends everything.
    The state of the fit is kept in the file `checkpoint` every 15 s, and taken from it at first
    where it holds one of the same cloud, options and threads: the result is then the same as
    without the interruption. A file that cannot be used is told of in the report.
    `preview` gets a coarse mesh of the unfinished field as GLB every few seconds.
    Returns the report. Raises InputError, FitError, SurfaceError, Cancelled.
    """
    watch = Watch(clock, progress, cancel, stop=stop, checkpoint=checkpoint, preview=preview)
    watch.enter("read")
    cloud = read_cloud(cloud_path)
    result = reconstruct_cloud(cloud, options, watch)
    out.mkdir(parents=True, exist_ok=True)
    write_glb(result.mesh, out / "mesh.glb")
    write_ply(result.mesh, out / "mesh.ply")
    save_field(result.fitted, out / "field.safetensors")
    slices = write_stack(result.fitted, options.surface.slices, out, options.threads)
    report = result.report | {"slices": slices}
    write_report(report, out / "report.json")
    return report


def write_stack(
    fitted: FittedField, count: int, out: Path, threads: int | None = None
) -> list[dict[str, Any]]:
    """`count` φ slices along each axis, as slices/{axis}/{index}.png.

    Returns what the report tells of them: where they lie, in the input's units, and where the plot
    is in each picture.
    """
    evaluate = field_of(fitted.field, "phi")
    with workers(threads or torch.get_num_threads()):
        written = write_slices(evaluate, fitted.similarity, fitted.box, count, out)
    return [s.cut.told(f"slices/{s.cut.axis}/{s.index}.png", "phi") for s in written]


def write_report(report: dict[str, Any], path: Path) -> None:
    """The report as indented JSON."""
    write_atomically(path, (json.dumps(report, indent=2, ensure_ascii=False) + "\n").encode())
