"""The whole pipeline on one screen: points in, surface out.

>>> import numpy as np
>>> from mpf_core import options_from, reconstruct
>>> rng = np.random.default_rng(0)
>>> sphere = rng.normal(size=(500, 3))
>>> sphere /= np.linalg.norm(sphere, axis=1, keepdims=True)
>>> quick = {"max_iterations": 200, "resolution": 32, "width": 64, "omega": 10.0, "threads": 1}
>>> options = options_from(quick)
>>> result = reconstruct(sphere, options)
>>> result.report["surface"]["watertight"]
True
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mpf_core.cloud.neighbors import Neighborhoods, median_spacing
from mpf_core.cloud.normalize import Similarity
from mpf_core.cloud.pointcloud import PointCloud
from mpf_core.cloud.prepare import PrepareOptions, prepare
from mpf_core.compiled import prepare_loops
from mpf_core.field import MetricPhaseField
from mpf_core.field.fitted import FittedField, theta_of
from mpf_core.field.footprint import Footprint
from mpf_core.field.precision import products_in
from mpf_core.fit.control import FitLog
from mpf_core.fit.initialize import Initialization
from mpf_core.fit.sampler import paper_pools, warm_pools
from mpf_core.fit.trainer import fit_field
from mpf_core.heeding import heeding
from mpf_core.known import known_of
from mpf_core.options import Options
from mpf_core.parallel import workers
from mpf_core.preview import Previews, coarse_mesh
from mpf_core.progress import CancelCheck, Clock, ProgressCallback
from mpf_core.quality.report import finished_report, frame_report, input_report, run_report
from mpf_core.surface.edit import edited
from mpf_core.surface.extraction import extract_mesh
from mpf_core.surface.fidelity import onto_data
from mpf_core.surface.forecast import Forecast, Until, area_of, pace_of, shadows_of
from mpf_core.surface.mesh import Mesh
from mpf_core.surface.resolution import shell_of
from mpf_core.watch import Watch

# What is kept for extraction, report and writing: at least of the time budget, at most of what is
# left of it when the fit begins, which would end with nothing otherwise.
LEAST_KEPT, MOST_KEPT = 0.05, 0.6
PADDING = 0.05  # of the normalised frame, around the samples


@dataclass(frozen=True)
class Reconstruction:
    """A fitted field with all that later extractions need, the mesh taken from it in the input's
    frame, and the report."""

    fitted: FittedField
    mesh: Mesh
    report: dict[str, Any]


def reconstruct(
    points: NDArray[np.floating],
    options: Options,
    *,
    normals: NDArray[np.floating] | None = None,
    colors: NDArray[np.uint8] | None = None,
    progress: ProgressCallback | None = None,
    cancel: CancelCheck | None = None,
    clock: Clock = time.monotonic,
) -> Reconstruction:
    """The surface of an unoriented cloud `points` (n, 3), in any units.

    normals: (n, 3) or None, kept with the cloud; the fit estimates its own. colors: (n, 3) RGB,
    carried over to the mesh. Raises CloudError for clouds that make no surface, Cancelled,
    FitError and SurfaceError.
    """
    cloud = PointCloud(
        np.asarray(points, dtype=np.float64),
        None if normals is None else np.asarray(normals, dtype=np.float64),
        colors,
    )
    return reconstruct_cloud(cloud, options, Watch(clock, progress, cancel))


def reconstruct_cloud(cloud: PointCloud, options: Options, watch: Watch) -> Reconstruction:
    """The pipeline itself."""
    threads = options.threads or torch.get_num_threads()
    with workers(threads), heeding(watch.check):
        return _reconstructed(cloud, options, watch, threads)


def _reconstructed(
    cloud: PointCloud, options: Options, watch: Watch, threads: int
) -> Reconstruction:
    watch.enter("prepare")
    with watch.compiling():
        prepare_loops(products_in(options.fit.precision), watch.cancel)
    prepared = prepare(cloud, PrepareOptions(outlier_sigma=options.fit.outlier_sigma))
    cloud = prepared.cloud
    similarity = Similarity.of(cloud.points)
    samples = similarity.to_normalised(cloud.points)
    watch.check()
    input_tree = cKDTree(samples)
    spacing = median_spacing(input_tree, threads)
    known = known_of(samples, options, watch, threads)
    neighbours, start = known.neighbours, known.start

    rng = np.random.default_rng(options.seed)
    if start is None:
        pools = paper_pools(neighbours, rng, threads=threads)
    else:
        pools = warm_pools(known.points, neighbours, start, options.fit, rng)

    box = np.stack([neighbours.points.min(0) - PADDING, neighbours.points.max(0) + PADDING])
    painted = None if cloud.colors is None else (input_tree, cloud.colors)
    previews: Previews | None = None
    if watch.preview is not None:
        draw = partial(coarse_mesh, neighbours, box, similarity, painted, watch.cancel)
        previews = Previews(draw, watch.preview, watch.clock)

    footprint = Footprint.of(
        samples,
        spacing=spacing,
        reach=neighbours.median_spacing,
        thickness=shell_of(start),
        colors=cloud.colors,
    )
    watch.enter("fit")
    forecast = _forecast(options, footprint, neighbours, start, watch.clock, threads)
    budget = options.fit.time_budget + watch.granted
    field, log = fit_field(
        pools,
        options.fit,
        watch.control(_deadline(budget, forecast, watch), previews),
        seed=options.seed,
        reliability=neighbours.normal_reliability,
        threads=threads,
    )

    watch.enter("extract")
    fitted = FittedField(field, similarity, box, footprint)
    until = Until(forecast, watch.clock, watch.begin + budget)
    taken = extract_mesh(fitted, options.surface, painted=painted, until=until)
    watch.check()
    mesh, fidelity = onto_data(
        taken.mesh,
        similarity,
        start,
        options.data,
        spacing=spacing,
        threads=threads,
        clock=watch.clock,
        end=until.last_step(len(taken.mesh.faces)),
    )
    watch.check()
    final = edited(mesh, options.surface, fitted, start)

    watch.enter("report")
    report = {
        **run_report(options),
        "input": input_report(
            cloud.notes,
            prepared.report,
            noise=similarity.length_to_input(known.noise),
            denoised=known.denoised,
        ),
        "frame": frame_report(similarity),
        "fit": fit_report(neighbours, start, log, previews),
        "extraction": taken.report,
        "surface": finished_report(final, cloud.points, fidelity),
    }
    watch.enter("done")
    report["timings"] = dict(watch.seconds)
    return Reconstruction(fitted, final.mesh, report)


def _forecast(
    options: Options,
    footprint: Footprint,
    neighbours: Neighborhoods,
    start: Initialization | None,
    clock: Clock,
    threads: int,
) -> Forecast:
    """What the mesh will cost; its field is evaluated as fast as any other of its size."""
    drawn = torch.Generator().manual_seed(options.seed)
    alike = MetricPhaseField(width=options.fit.width, generator=drawn)
    sheets = 0.0 if start is None else 1 - start.seeded
    return Forecast(
        options.surface,
        footprint,
        area_of(neighbours, sheets),
        shadows_of(neighbours, sheets),
        pace_of(theta_of(alike), clock, threads),
    )


def _deadline(budget: float, forecast: Forecast, watch: Watch) -> float:
    """Seconds after the beginning at which the fit must end, for all to end in time."""
    needed = forecast.seconds(forecast.fineness)
    left = budget - (watch.clock() - watch.begin)
    return budget - float(min(max(needed, LEAST_KEPT * budget), max(MOST_KEPT * left, 0.0)))


def fit_report(
    neighbours: Neighborhoods,
    start: Initialization | None,
    log: FitLog,
    previews: Previews | None = None,
) -> dict[str, Any]:
    """What a report tells of a fit."""
    last = log.history[-1] if log.history else None
    return {
        "iterations": log.iterations,
        "planned_iterations": log.planned,
        "stopped_by": log.stopped_by,
        "seconds": round(log.seconds, 3),
        "iterations_per_second": round(log.iterations / max(log.seconds, 1e-9), 3),
        "kept_iteration": log.kept,
        "resumed_from": log.resumed_from,
        "preview_seconds": None if previews is None else round(previews.seconds, 3),
        "retries": log.retries,
        "notes": log.notes,
        "omega": round(log.omega, 3),
        "normal_term": log.normal_term,
        "precision": log.precision,
        "loops": log.loops,
        "normal_reliability": round(neighbours.normal_reliability, 4),
        "enclosed_regions": None if start is None else start.space.enclosures,
        "enclosing_share": None if start is None else round(start.seeded, 4),
        "losses": {} if last is None else last.losses,
        "history": [
            {"iteration": e.iteration, "seconds": round(e.seconds, 3), **e.losses}
            for e in log.history
        ],
    }
