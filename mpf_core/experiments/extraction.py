"""What the extraction costs on a fitted field: `mpf experiment extraction`.

One field, fitted once and kept in the folder; the sparse extraction at rising resolutions against
θ at every vertex of the full grid, and θ in single and half precision against double.
"""

from __future__ import annotations

import copy
import resource
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn import functional

from mpf_core.experiments.asked import Asked
from mpf_core.experiments.shapes import sample
from mpf_core.experiments.trial import Row
from mpf_core.field.artefact import load_field, save_field
from mpf_core.field.fitted import FittedField, theta_of
from mpf_core.options import options_from
from mpf_core.parallel import workers
from mpf_core.pipeline import reconstruct
from mpf_core.surface.isosurface import Grid, Isosurface, extract

SHAPE = "holed-body"  # a closed body with handles, area 7.3 in a box of side 2
POINTS = 20_000
PRODUCT = 2048  # rows of the matrix product that tells the machine's speed, as wide as a layer
REPEATS = 2
PROBES = 20_000  # vertices at which precisions are compared

Floats = NDArray[np.float64]


def measured(directory: Path, asked: Asked, threads: int = 2) -> list[Row]:
    """All rows, in the order of the table; `directory` keeps the field."""
    fitted = _field(directory / "field.safetensors", asked.quick, asked.budget)
    sparse, full = ((64, 96), 64) if asked.quick else ((256, 512, 1024), 256)
    rows: list[Row] = []
    with workers(threads):
        rows.append({"what": "float32 matrix product", "GFLOP/s": _speed(threads)})
        surface = None
        for resolution in sparse:
            row, found = _sparse(fitted, resolution, 1 if resolution > 512 else REPEATS)
            rows.append(row)
            surface = surface or found
        rows.append(_dense(fitted, full))
        assert surface is not None
        rows += _precisions(fitted, surface)
    return rows


def _field(path: Path, quick: bool, budget: float | None) -> FittedField:
    if not path.is_file():
        options: Row = {"max_iterations": 60, "preset": "draft"} if quick else {}
        options |= {"resolution": 64, "slices": 0}
        if budget is not None:
            options["time_budget"] = budget
        path.parent.mkdir(parents=True, exist_ok=True)
        save_field(reconstruct(sample(SHAPE, POINTS, 0), options_from(options)).fitted, path)
    return load_field(path)


def _speed(threads: int) -> float:
    """GFLOP/s of a float32 product as one layer makes it, on so many threads."""
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    a, b = torch.rand(PRODUCT, 256), torch.rand(256, 256)
    seconds = min(_timed(lambda: [a @ b for _ in range(50)])[0] for _ in range(10))
    torch.set_num_threads(before)
    return 50 * 2 * PRODUCT * 256 * 256 / seconds / 1e9


def _timed(job: Callable[[], Any]) -> tuple[float, float, Any]:
    """Seconds on the wall, seconds of processors, and what came out."""
    wall, busy = time.perf_counter(), time.process_time()
    result = job()
    return time.perf_counter() - wall, time.process_time() - busy, result


def _sparse(fitted: FittedField, resolution: int, repeats: int) -> tuple[Row, Isosurface]:
    footprint = fitted.footprint
    grid = Grid.around(fitted.box[0], fitted.box[1], resolution)
    before = _resident()

    def once() -> Isosurface:
        reach = footprint.reach + footprint.cover
        return extract(theta_of(fitted.field), grid, footprint.tree, reach=reach)

    runs = [_timed(once) for _ in range(repeats)]
    surface: Isosurface = runs[0][2]
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    row = {
        "what": f"sparse {resolution}³",
        "seconds": min(run[0] for run in runs),
        "processor seconds": min(run[1] for run in runs),
        "crossed cells": surface.crossed_cells,
        "evaluations": surface.evaluations,
        "evaluations per crossed cell": surface.evaluations / surface.crossed_cells,
        "peak MiB": peak - before,
    }
    return row, surface


def _resident() -> float:
    """MiB of memory in use now."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 2**20


def _dense(fitted: FittedField, resolution: int) -> Row:
    """θ at every vertex of the same box; marching cubes would come on top."""
    grid = Grid.around(fitted.box[0], fitted.box[1], resolution)
    theta = theta_of(fitted.field)
    axes = [np.arange(n + 1) for n in grid.shape]

    def everywhere() -> int:
        count = 0
        for x in axes[0]:
            at = np.stack(np.meshgrid([x], axes[1], axes[2], indexing="ij"), -1).reshape(-1, 3)
            count += len(theta(grid.points(at)))
        return count

    wall, busy, count = _timed(everywhere)
    return {
        "what": f"every vertex of {resolution}³",
        "seconds": wall,
        "processor seconds": busy,
        "evaluations": count,
    }


def _precisions(fitted: FittedField, surface: Isosurface) -> list[Row]:
    """How far the roots move where θ is computed in less than double precision.

    A vertex moves by the error of θ over its slope, which the Eikonal terms hold near 1.
    """
    every = max(1, len(surface.vertices) // PROBES)
    at = surface.vertices[::every]
    # Beside the roots: on them a coarse format rounds to an exact 0 and looks better than it is.
    beside = np.random.default_rng(0).uniform(-0.5, 0.5, at.shape) * surface.grid.cell
    points = torch.from_numpy(at + beside)
    exact = _theta(fitted, points, torch.float64)[0]
    rows = []
    for name, kind in (("float32", torch.float32), ("bfloat16", torch.bfloat16)):
        values, seconds = _theta(fitted, points, kind)
        error = (values - exact).abs().numpy()
        rows.append(
            {
                "what": f"θ in {name}",
                "µs an evaluation": 1e6 * seconds / len(points),
                "error, median": float(np.median(error)),
                "error, largest": float(error.max()),
            }
        )
    return rows


def _theta(
    fitted: FittedField, points: torch.Tensor, kind: torch.dtype
) -> tuple[torch.Tensor, float]:
    """θ (n,) with the hidden layers in this precision; the first, which places the waves, never in
    less than single. And the processor seconds it took."""
    net = copy.deepcopy(fitted.field.siren).to(kind)
    first = kind if kind == torch.float64 else torch.float32
    weight, bias = (getattr(fitted.field.siren, f"input_{p}").to(first) for p in ("weight", "bias"))

    def theta() -> torch.Tensor:
        s1 = functional.linear(points.to(first), weight, bias).sin_().to(kind)
        s2 = functional.linear(s1, net.shared_weight, net.shared_bias).sin_()
        s3 = functional.linear(s2, net.phase_weight, net.phase_bias).sin_()
        return s3 @ net.phase_output + net.phase_offset

    with torch.inference_mode():
        runs = [_timed(theta) for _ in range(REPEATS)]
    return runs[0][2].double(), min(run[1] for run in runs)
