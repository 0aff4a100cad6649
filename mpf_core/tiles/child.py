"""One tile fitted, on any machine: its file in, a field and what its samples say out."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from mpf_core.cloud.neighbors import Neighborhoods
from mpf_core.compiled import prepare_loops
from mpf_core.errors import FitError
from mpf_core.field.artefact import save_field
from mpf_core.field.fitted import FittedField
from mpf_core.field.footprint import Footprint
from mpf_core.field.precision import products_in
from mpf_core.files import write_atomically
from mpf_core.fit.inherited import faced, inherited
from mpf_core.fit.initialize import Facing, Initialization
from mpf_core.fit.sampler import warm_pools
from mpf_core.fit.trainer import FEWEST, fit_field
from mpf_core.heeding import heeding
from mpf_core.known import Known, known_of
from mpf_core.options import Options
from mpf_core.outputs import write_report
from mpf_core.parallel import workers
from mpf_core.pipeline import fit_report
from mpf_core.progress import CancelCheck, Clock, Progress, ProgressCallback
from mpf_core.quality.report import frame_report, run_report
from mpf_core.surface.fidelity import sheets_of
from mpf_core.surface.patches import patches_of
from mpf_core.surface.resolution import shell_of
from mpf_core.tiles.patchfile import PATCHES, patch_bytes
from mpf_core.tiles.plan import TileData, read_tile
from mpf_core.watch import Watch

# Share of a tile's fit that is done when each stage begins.
BEGINS = {"read": 0.0, "prepare": 0.01, "initialize": 0.1, "fit": 0.15, "report": 0.95, "done": 1.0}
KEPT = 0.05  # of the time budget, for what comes after the fit
FIELD, REPORT = "field.safetensors", "report.json"
HURRIED = 150  # iterations of tiles that were not begun when the caller wanted to stop: a surface


def fit_tile_file(
    tile_path: str | Path,
    out: str | Path,
    options: Options,
    *,
    progress: ProgressCallback | None = None,
    stop: CancelCheck | None = None,
    cancel: CancelCheck | None = None,
    checkpoint: Path | None = None,
    clock: Clock = time.monotonic,
) -> dict[str, Any]:
    """Fit one tile and write field.safetensors, patches.safetensors (what its samples say, for the
    last step) and report.json, in this order, to `out`.

    `time_budget` is that of the tile. `stop` ends its fit with what it has come to, but not before
    there is a surface; `cancel` ends everything; the state of the fit is kept in `checkpoint` as
    `reconstruct_file` keeps it. Returns the report. Raises TileError, FitError, Cancelled.
    """
    out = Path(out)
    soon = _Soon(stop, progress)
    watch = Watch(
        clock, soon.progress, cancel, stop=soon.stop, checkpoint=checkpoint, begins=BEGINS
    )
    watch.enter("read")
    tile = read_tile(tile_path)
    threads = options.threads or torch.get_num_threads()
    with workers(threads), heeding(watch.check):
        report = _fitted(tile, out, options, watch, threads)
    report["timings"] = dict(watch.seconds)
    write_report(report, out / REPORT)
    watch.enter("done")
    return report


def fit_tile_in_time(
    tile_path: str | Path,
    out: str | Path,
    options: Options,
    *,
    progress: ProgressCallback | None = None,
    stop: CancelCheck | None = None,
    cancel: CancelCheck | None = None,
    checkpoint: Path | None = None,
    clock: Clock = time.monotonic,
) -> dict[str, Any]:
    """As `fit_tile_file`, but where `stop` says so before anything is fitted, of few iterations.

    Such a fit is planned for these, and so no state is kept that a longer one could not go on from.
    """
    begun = checkpoint is not None and checkpoint.exists()
    if stop is not None and not begun and stop():
        few = min(HURRIED, options.fit.max_iterations)
        options = replace(options, fit=replace(options.fit, max_iterations=few))
        stop = checkpoint = None
    return fit_tile_file(
        tile_path, out, options,
        progress=progress, stop=stop, cancel=cancel, checkpoint=checkpoint, clock=clock,
    )  # fmt: skip


class _Soon:
    """A wish to stop that waits until there is a surface."""

    def __init__(self, stop: CancelCheck | None, progress: ProgressCallback | None):
        self._stop, self._progress, self._iteration = stop, progress, 0

    def progress(self, progress: Progress) -> None:
        self._iteration = progress.iteration or self._iteration
        if self._progress is not None:
            self._progress(progress)

    def stop(self) -> bool:
        return self._stop is not None and self._iteration >= FEWEST and self._stop()


def _fitted(
    tile: TileData, out: Path, options: Options, watch: Watch, threads: int
) -> dict[str, Any]:
    watch.enter("prepare")
    with watch.compiling():
        prepare_loops(products_in(options.fit.precision), watch.cancel)
    samples = tile.similarity.to_normalised(tile.points)

    def begin(neighbours: Neighborhoods, first: Facing | None) -> Initialization:
        return inherited(neighbours, tile.phase, first, threads=threads)

    face = partial(faced, phase=tile.phase, threads=threads)
    known = known_of(samples, options, watch, threads, face=face, begin=begin)
    neighbours, start = known.neighbours, known.start
    if start is None:
        raise FitError("tiles cannot be fitted without a warm start", advice="Set warm_start.")
    rng = np.random.default_rng(options.seed)
    pools = warm_pools(known.points, neighbours, start, options.fit, rng)
    spacing = tile.similarity.length_to_normalised(tile.spacing)
    footprint = Footprint.of(
        samples, spacing=spacing, reach=neighbours.median_spacing, thickness=shell_of(start)
    )
    watch.enter("fit")
    field, log = fit_field(
        pools,
        options.fit,
        watch.control((1 - KEPT) * options.fit.time_budget + watch.granted),
        seed=options.seed,
        reliability=neighbours.normal_reliability,
        threads=threads,
    )
    watch.enter("report")
    out.mkdir(parents=True, exist_ok=True)
    low, high = np.clip(tile.similarity.to_normalised(tile.support), -1.0, 1.0)
    save_field(FittedField(field, tile.similarity, np.stack([low, high]), footprint), out / FIELD)
    _write_patches(known, start, options, out, spacing, threads)
    return {
        **run_report(options),
        "tile": {"index": tile.index, "tiles": tile.tiles, "samples": len(samples)},
        "frame": frame_report(tile.similarity),
        "fit": fit_report(neighbours, start, log),
    }


def _write_patches(
    known: Known, start: Initialization, options: Options, out: Path, spacing: float, threads: int
) -> None:
    if options.data.fidelity == "off":
        return
    patches = patches_of(
        known.neighbours,
        start.normals,
        sheets_of(start.bounds),
        options.data.sheet_thickness * spacing,
        threads,
    )
    write_atomically(out / PATCHES, patch_bytes(patches, known.neighbours.median_spacing))
