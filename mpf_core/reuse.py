"""A fitted field used again: meshes and slices without refitting."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import torch

from mpf_core.errors import OptionsError, OutsideBox
from mpf_core.extraction_options import AXES, FIELDS, ExtractionOptions, extraction_to_mapping
from mpf_core.field.blendfile import load_field
from mpf_core.field.fitted import Fitted
from mpf_core.files import write_atomically
from mpf_core.heeding import heeding
from mpf_core.options import SurfaceOptions
from mpf_core.outputs import write_report, write_stack
from mpf_core.parallel import workers
from mpf_core.progress import CancelCheck, Clock, ProgressCallback
from mpf_core.quality.report import frame_report, surface_report, versions_report
from mpf_core.surface.edit import edited
from mpf_core.surface.export import write_glb, write_ply
from mpf_core.surface.extraction import Extraction, extract_mesh
from mpf_core.surface.slices import cut, evenly
from mpf_core.watch import Watch

# Share of an extraction that is done when each stage begins.
BEGINS = {"read": 0.0, "extract": 0.05, "slices": 0.7, "report": 0.9, "done": 1.0}


def extract(
    fitted: Fitted,
    options: SurfaceOptions | None = None,
    *,
    threads: int | None = None,
    cancel: CancelCheck | None = None,
) -> Extraction:
    """The surface of a fitted field as a mesh, and what the report tells of how it was taken.

    At the same resolution and with as many threads it is what the run that fitted the field took
    from it, bit for bit, before the vertices moved onto the data (option `fidelity`): that needs
    the cloud. Colours are those of the samples that the field keeps. Raises NoSurface,
    ResolutionTooHigh, Cancelled.
    """
    options = options or SurfaceOptions()
    check = Watch(time.monotonic, None, cancel).check
    with workers(threads or torch.get_num_threads()), heeding(check):
        taken = extract_mesh(fitted, options)
        final = edited(taken.mesh, options, fitted)
    told = dict(final.edits)
    if final.double_cover is not None:
        told["double_cover"] = final.double_cover
    return Extraction(final.mesh, taken.report | told)


def slice_png(fitted: Fitted, *, axis: str, at: float | None = None, name: str = "phi") -> bytes:
    """PNG of φ, r, θ or P (`name` in phi, r, theta, P) on the plane `axis` = `at`.

    at: in the input's units, the middle of the box if not given. Raises OptionsError, OutsideBox.
    """
    if axis not in AXES or name not in FIELDS:
        raise OptionsError(
            f"there is no slice of {name!r} across {axis!r}",
            advice=f"Axes are {', '.join(AXES)}, fields {', '.join(FIELDS)}.",
        )
    place = (
        float(fitted.box[:, AXES.index(axis)].mean()) if at is None else inside(fitted, axis, at)
    )
    evaluate = fitted.values(name)
    with workers(torch.get_num_threads()):
        return cut(evaluate, fitted.similarity, fitted.box, axis, place, field=name).picture


def inside(fitted: Fitted, axis: str, at: float) -> float:
    """The normalised coordinate of `at` along `axis`; raises OutsideBox beyond the field's box."""
    column = AXES.index(axis)
    corners = fitted.similarity.to_input(fitted.box)[:, column]
    place = float((at - fitted.similarity.center[column]) * fitted.similarity.scale)
    low, high = fitted.box[:, column]
    # The corners in the input's units, as they are printed and given back, count as inside: ten
    # digits are 1e-9 of a coordinate far from the origin.
    slack = 1e-6 * float((fitted.box[1] - fitted.box[0]).max())
    slack += 1e-9 * float(np.abs(corners).max()) * fitted.similarity.scale
    if not low - slack <= place <= high + slack:
        raise OutsideBox(
            f"{axis} = {at:.10g} lies outside the box of the field",
            where="at",
            advice=f"Use a position from {corners[0]:.10g} to {corners[1]:.10g}.",
        )
    return min(max(place, float(low)), float(high))


def extract_file(
    field_path: Path,
    out: Path,
    options: ExtractionOptions,
    *,
    progress: ProgressCallback | None = None,
    cancel: CancelCheck | None = None,
    clock: Clock = time.monotonic,
) -> dict[str, Any]:
    """Read a field and write what is asked for of mesh.glb, mesh.ply, slices/{axis}/{index}.png
    and slices/{field}/{axis}/{index}.png, and report.json.

    Returns the report. Raises FieldError, OutsideBox, SurfaceError, Cancelled.
    """
    watch = Watch(clock, progress, cancel, begins=BEGINS)
    watch.enter("read")
    fitted = load_field(field_path)
    places = _places(fitted, options)  # all of them judged before any work
    out.mkdir(parents=True, exist_ok=True)
    taken: Extraction | None = None
    if options.mesh:
        watch.enter("extract")
        taken = extract(fitted, options.surface, threads=options.threads, cancel=cancel)
        write_glb(taken.mesh, out / "mesh.glb")
        write_ply(taken.mesh, out / "mesh.ply")
    watch.enter("slices")
    slices = write_stack(fitted, options.surface.slices, out, options.threads)
    with workers(options.threads or torch.get_num_threads()):
        slices += _write_cuts(fitted, places, out, watch)
    watch.enter("report")
    report = report_of(fitted, options, taken)
    report |= {"slices": slices, "timings": dict(watch.seconds)}
    write_report(report, out / "report.json")
    watch.enter("done")
    return report


def report_of(
    fitted: Fitted, options: ExtractionOptions, taken: Extraction | None
) -> dict[str, Any]:
    """What was asked for and, if a mesh was, what it is like; distances are to the kept samples."""
    report: dict[str, Any] = {
        "options": extraction_to_mapping(options),
        **versions_report(),
        "frame": frame_report(fitted.similarity),
    }
    if taken is not None:
        kept = fitted.similarity.to_input(fitted.footprint.points)
        report |= {"extraction": taken.report, "surface": surface_report(taken.mesh, kept)}
    return report


def _places(fitted: Fitted, options: ExtractionOptions) -> list[tuple[str, str, list[float]]]:
    """Field, axis and normalised positions of every cut."""
    return [
        (
            one.field,
            one.axis,
            evenly(fitted.box, one.axis, one.count)
            if one.count
            else [inside(fitted, one.axis, at) for at in one.at],
        )
        for one in options.cuts
    ]


def _write_cuts(
    fitted: Fitted, places: list[tuple[str, str, list[float]]], out: Path, watch: Watch
) -> list[dict[str, Any]]:
    """Each field's cuts across an axis are numbered in the order in which they were asked for."""
    numbers: dict[tuple[str, str], int] = {}
    written = []
    for name, axis, positions in places:
        evaluate = fitted.values(name)
        for place in positions:
            watch.check()
            made = cut(evaluate, fitted.similarity, fitted.box, axis, place, field=name)
            index = numbers.get((name, axis), 0)
            numbers[name, axis] = index + 1
            file = f"slices/{name}/{axis}/{index}.png"
            (out / file).parent.mkdir(parents=True, exist_ok=True)
            write_atomically(out / file, made.picture)
            written.append(made.told(file, name))
    return written
