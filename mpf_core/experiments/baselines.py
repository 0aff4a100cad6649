"""What people would use instead: Open3D's screened Poisson, ball pivoting and alpha shape.

Each gets the points alone, as MPF does, and estimates what else it needs. Their lengths are
multiples of the cloud's spacing (median distance to the sixth neighbour); the factors were chosen
once, on a sheet, a cube with a sheet and a thin plate, clean and noisy, and hold for every row.
"""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mpf_core.cloud.neighbors import median_spacing
from mpf_core.errors import NoSurface, OptionsError
from mpf_core.experiments import presets
from mpf_core.experiments.asked import QUICK_POINTS, Asked
from mpf_core.experiments.trial import Method, Outcome, Trial
from mpf_core.surface.mesh import Mesh

NORMAL_NEIGHBOURS = 30  # Open3D's tutorials'
DEPTHS = (6, 10)  # of Poisson's octree: 64³ to 1024³
CELL = 0.5  # spacings: the octree's finest cell is at most so wide
TRIM = 1.0  # spacings beyond which Poisson's surface is cut off; it is always closed before
BALLS = (0.7, 1.0, 1.4, 2.0, 2.8)  # spacings: radii of the balls, one pass each
ALPHA = 3.0  # spacings: smaller ones leave clean sheets in pieces, larger ones fill noisy bodies

Points = NDArray[np.float64]


def required() -> None:
    """Raises OptionsError where Open3D cannot be used."""
    try:
        importlib.import_module("open3d")
    except (ImportError, OSError) as error:  # the second: libraries of the system
        raise OptionsError(
            f"the baselines need Open3D: {error}",
            advice="Install the extra: pip install 'metric-phase-fields[bench]' (on Debian also "
            "libusb-1.0-0 and libgl1).",
        ) from error


def poisson(points: Points, trial: Trial) -> Outcome:
    """Screened Poisson on estimated, consistently oriented normals, as it comes: closed."""
    del trial
    return _timed(points, lambda cloud, spacing: _poisson(cloud, spacing)[0])


def poisson_trimmed(points: Points, trial: Trial) -> Outcome:
    """The same without what lies farther than TRIM spacings from every sample."""
    del trial

    def trimmed(cloud: Any, spacing: float) -> Any:
        mesh, tree = _poisson(cloud, spacing)
        distance, _ = tree.query(np.asarray(mesh.vertices))
        mesh.remove_vertices_by_mask(distance > TRIM * spacing)
        return mesh

    return _timed(points, trimmed)


def ball_pivoting(points: Points, trial: Trial) -> Outcome:
    """Balls of rising radii rolled over the samples, on estimated, oriented normals."""
    del trial

    def pivoted(cloud: Any, spacing: float) -> Any:
        import open3d

        _oriented(cloud)
        radii = open3d.utility.DoubleVector([factor * spacing for factor in BALLS])
        return open3d.geometry.TriangleMesh.create_from_point_cloud_ball_pivoting(cloud, radii)

    return _timed(points, pivoted)


def alpha_shape(points: Points, trial: Trial) -> Outcome:
    """The boundary of what balls of radius ALPHA spacings cannot empty; needs no normals."""
    del trial

    def shaped(cloud: Any, spacing: float) -> Any:
        import open3d

        make = open3d.geometry.TriangleMesh.create_from_point_cloud_alpha_shape
        return make(cloud, ALPHA * spacing)

    return _timed(points, shaped)


BASELINES: dict[str, Method] = {
    "screened Poisson": poisson,
    "Poisson, trimmed": poisson_trimmed,
    "ball pivoting": ball_pivoting,
    "alpha shape": alpha_shape,
}


def trials(asked: Asked) -> list[Trial]:
    """Every cloud of `presets`, clean and noisy, once for each baseline; with a preset also MPF."""
    if asked.quick:
        made = [Trial("wave, 0.5 %", "wave", QUICK_POINTS, noise=presets.NOISE)]
    else:
        once = presets.PRESETS[0]
        every = presets.trials(asked.meshes, asked.clouds)
        made = [t for t in every if dict(t.options)["preset"] == once]
        made = [replace(t, label=t.label.removesuffix(f", {once}"), options=()) for t in made]
    names = [*BASELINES, *(["mpf"] if asked.preset else [])]
    return [replace(t, method=name) for t in made for name in names]


def _timed(points: Points, make: Callable[[Any, float], Any]) -> Outcome:
    """From the points in memory to the mesh in memory; spacing and normals included."""
    import open3d

    begin, busy = time.perf_counter(), time.process_time()
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
    spacing = median_spacing(cKDTree(points))
    with open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error):
        found = make(cloud, spacing)
    mesh = Mesh(np.asarray(found.vertices, np.float64), np.asarray(found.triangles, np.int64))
    if len(mesh.faces) == 0:
        raise NoSurface("the method made no triangle")
    return Outcome(
        mesh,
        {"open3d": open3d.__version__, "spacing": spacing},
        seconds=time.perf_counter() - begin,
        figures={"processor_seconds": time.process_time() - busy},
    )


def _oriented(cloud: Any) -> None:
    import open3d

    cloud.estimate_normals(open3d.geometry.KDTreeSearchParamKNN(NORMAL_NEIGHBOURS))
    cloud.orient_normals_consistent_tangent_plane(NORMAL_NEIGHBOURS)


def _poisson(cloud: Any, spacing: float) -> tuple[Any, cKDTree]:
    import open3d

    _oriented(cloud)
    points = np.asarray(cloud.points)
    longest = float(np.ptp(points, axis=0).max())
    depth = int(np.clip(np.ceil(np.log2(1.1 * longest / (CELL * spacing))), *DEPTHS))
    make = open3d.geometry.TriangleMesh.create_from_point_cloud_poisson
    return make(cloud, depth=depth)[0], cKDTree(points)
