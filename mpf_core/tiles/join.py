"""The fields of all tiles as one, and the surface taken from it, as from the field of one fit."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mpf_core.cloud.pointcloud import PointCloud
from mpf_core.cloud.reader import read_cloud
from mpf_core.cloud.thinning import ANALYSED
from mpf_core.errors import TileFormat
from mpf_core.field.artefact import load_field
from mpf_core.field.blend import BlendedField, Tile
from mpf_core.field.fitted import FittedField
from mpf_core.field.footprint import Footprint
from mpf_core.field.header import number, whole
from mpf_core.heeding import heeding
from mpf_core.options import Options
from mpf_core.outputs import write_result
from mpf_core.parallel import workers
from mpf_core.pipeline import PADDING
from mpf_core.progress import CancelCheck, Clock, ProgressCallback
from mpf_core.quality.report import finished_report, frame_report, run_report
from mpf_core.surface.edit import edited
from mpf_core.surface.extraction import extract_mesh
from mpf_core.surface.mesh import Mesh
from mpf_core.tiles.child import REPORT
from mpf_core.tiles.lay import onto_patches
from mpf_core.tiles.plan import Plan, as_tile_errors, read_plan
from mpf_core.tiles.split import prepared
from mpf_core.watch import Watch

# Share of the joining that is done when each stage begins.
BEGINS = {"read": 0.0, "extract": 0.1, "fidelity": 0.5, "report": 0.8, "done": 1.0}

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TiledReconstruction:
    """As `pipeline.Reconstruction`, of many networks."""

    fitted: BlendedField
    mesh: Mesh
    report: dict[str, Any]


def join_files(
    plan_dir: str | Path,
    field_paths: Sequence[str | Path],
    cloud_path: str | Path,
    out: str | Path,
    options: Options,
    *,
    progress: ProgressCallback | None = None,
    cancel: CancelCheck | None = None,
    clock: Clock = time.monotonic,
) -> dict[str, Any]:
    """Blend the tiles' fields, take the surface, and write to `out` what `reconstruct_file` writes.

    field_paths: field.safetensors of each tile in the order of the plan; patches.safetensors lies
    beside each, or the last step is left out. Of the plan's folder plan.json and side.safetensors
    are read, no tiles. Returns the report. Raises InputError, SurfaceError, Cancelled.
    """
    watch = Watch(clock, progress, cancel, begins=BEGINS)
    paths = [Path(path) for path in field_paths]
    result = joined(Path(plan_dir), paths, Path(cloud_path), options, watch)
    return write_result(result, Path(out), options)


def joined(
    plan_dir: Path, field_paths: list[Path], cloud_path: Path, options: Options, watch: Watch
) -> TiledReconstruction:
    """The same without writing."""
    threads = options.threads or torch.get_num_threads()
    with workers(threads), heeding(watch.check):
        watch.enter("read")
        plan = read_plan(plan_dir)
        fields = [load_field(path) for path in field_paths]
        cloud, _ = prepared(read_cloud(cloud_path), options)
        samples = plan.similarity.to_normalised(cloud.points)
        blend = blended(plan, fields, cloud, samples)
        watch.enter("extract")
        painted = None if cloud.colors is None else (cKDTree(samples), cloud.colors)
        taken = extract_mesh(blend, options.surface, painted=painted)
        del painted
        watch.enter("fidelity")
        mesh, fidelity = onto_patches(
            taken.mesh, blend, field_paths, plan.shell, options.data, threads, watch.clock
        )
        watch.check()
        final = edited(mesh, options.surface, blend)
        watch.enter("report")
        report = {
            **run_report(options),
            "input": plan.report.get("input"),
            "frame": frame_report(plan.similarity),
            **tiles_report(plan, fields, field_paths),
            "extraction": taken.report,
            "surface": finished_report(final, cloud.points, fidelity),
        }
        watch.enter("done")
        report["timings"] = dict(watch.seconds)
    return TiledReconstruction(blend, final.mesh, report)


def blended(
    plan: Plan, fields: Sequence[FittedField], cloud: PointCloud, samples: Array
) -> BlendedField:
    """The fields of a plan's tiles, in its order, as one; `samples` (n, 3) are those of the cloud
    in the whole's frame. Raises TileFormat where fields are missing."""
    if len(fields) != plan.tiles:
        raise TileFormat(f"there are {len(fields)} fields of {plan.tiles} tiles")
    unit = [plan.similarity.scale / field.similarity.scale for field in fields]
    thin = [
        u * f.footprint.thickness
        for u, f in zip(unit, fields, strict=True)
        if f.footprint.thickness is not None
    ]
    footprint = Footprint.of(
        samples,
        spacing=plan.spacing,
        reach=float(np.median([u * f.footprint.reach for u, f in zip(unit, fields, strict=True)])),
        thickness=min(thin, default=None),
        colors=cloud.colors,
        most=ANALYSED,
    )
    box = np.stack([samples.min(0) - PADDING, samples.max(0) + PADDING])
    tiles = tuple(Tile(field.field, field.similarity) for field in fields)
    return BlendedField(tiles, plan.partition, plan.side, plan.similarity, box, footprint)


def tiles_report(
    plan: Plan, fields: Sequence[FittedField], field_paths: Sequence[Path]
) -> dict[str, Any]:
    """`fit` and `tiles` of the report, from those of the tiles that lie beside their fields;
    lengths in the input's units."""
    cores = plan.partition.boxes(np.array([[-1.0] * 3, [1.0] * 3]))
    fits = [_fit_beside(path) for path in field_paths]
    each = [
        {
            "samples": count,
            "core": plan.similarity.to_input(core).tolist(),
            "scale": field.similarity.scale,
            **{name: fit.get(name) for name in ("iterations", "seconds", "stopped_by")},
        }
        for count, core, field, fit in zip(plan.samples, cores, fields, fits, strict=True)
    ]
    ends = sorted({str(fit["stopped_by"]) for fit in fits if "stopped_by" in fit})
    tiles = {
        "count": plan.tiles,
        "shell": plan.shell,
        "ramps": [plan.similarity.length_to_input(2 * cut.half) for cut in plan.partition.cuts],
        "each": each,
    }
    fit = {
        "iterations": sum(fit.get("iterations", 0) for fit in fits),
        "planned_iterations": sum(fit.get("planned_iterations", 0) for fit in fits),
        "seconds": round(sum(fit.get("seconds", 0.0) for fit in fits), 3),
        "stopped_by": ", ".join(ends),
        "enclosed_regions": plan.report.get("enclosed_regions"),
        "enclosing_share": plan.report.get("enclosing_share"),
    }
    return {"fit": fit, "tiles": tiles}


def _fit_beside(path: Path) -> dict[str, Any]:
    """What the tile's own report tells of its fit; nothing where there is none."""
    try:
        told = json.loads(path.with_name(REPORT).read_bytes())["fit"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return {}
    return _judged(told) if isinstance(told, dict) else {}


def _judged(told: dict[str, Any]) -> dict[str, Any]:
    """Of these figures those that are there. Raises TileFormat: they may come from anywhere."""
    found: dict[str, Any] = {}
    with as_tile_errors():
        for name in ("iterations", "planned_iterations"):
            if name in told:
                found[name] = whole(told, name, 0, 10**9)
        if "seconds" in told:
            found["seconds"] = number(told, "seconds", 0.0, 1e9)
    if "stopped_by" in told:
        found["stopped_by"] = str(told["stopped_by"])[:80]
    return found
