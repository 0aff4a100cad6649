"""How long the way from the fitted field to the written mesh will take, before the field is fitted.

By counts: cells that the surface will cross, triangles that will be left. These follow from its
area, those from its shadows along the axes, and both from the samples. What each costs is told in
evaluations of θ, whose pace is measured.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mpf_core.cloud.neighbors import Neighborhoods
from mpf_core.field.footprint import Footprint
from mpf_core.options import SurfaceOptions
from mpf_core.surface.coarsen import faces_for, most_faces
from mpf_core.surface.resolution import choose_resolution

PER_CELL = 9.5  # evaluations per crossed cell: 2.2 of θ, the rest mostly merging of triangles
PER_FACE = 15.0  # for each triangle left: the last step, normals, crossings, report, writing
FIXED = 1.5  # seconds
PROBES, ROUNDS = 16_384, 4  # points at which the pace is measured, and how often; the best counts

Evaluate = Callable[[NDArray[np.float64]], NDArray[np.float32]]


def seconds_after_fit(
    options: SurfaceOptions,
    footprint: Footprint,
    area: float,
    shadows: NDArray[np.float64],
    evaluate: Evaluate,
    clock: Callable[[], float],
) -> float:
    """From extraction to the written file, for a mesh of `area` with `shadows` (3,), normalised.
    `evaluate` need not be the field that is meant, only as large."""
    fineness = choose_resolution(options, footprint)
    cells = crossed(shadows, 2 / fineness.cells / np.array(fineness.finer))
    faces = 2 * cells
    if options.coarsen == "auto" and options.resolution is None:
        faces = min(faces, faces_for(area, footprint.spacing, most_faces(options)))
    points = np.random.default_rng(0).uniform(-1, 1, (PROBES, 3))
    seconds = []
    for _ in range(ROUNDS):
        begin = clock()
        evaluate(points)
        seconds.append(clock() - begin)
    pace = min(seconds) / PROBES
    return FIXED + pace * (PER_CELL * cells + PER_FACE * faces)


def crossed(shadows: NDArray[np.float64], steps: NDArray[np.float64]) -> float:
    """How many cells with sides `steps` (3,) a surface with `shadows` (3,) crosses: a plane crosses
    those whose centres are within half their width along its normal."""
    return float((shadows * steps).sum() / np.prod(steps))


def area_of(neighbours: Neighborhoods, sheets: float) -> float:
    """Of the mesh around samples, of which a share `sheets` is of open sheets with two walls."""
    return (1 + sheets) * float(neighbours.areas.sum())


def shadows_of(neighbours: Neighborhoods, sheets: float) -> NDArray[np.float64]:
    """(3,) area of the same mesh as seen along each axis, of what hides behind other parts, too."""
    return (1 + sheets) * np.asarray(neighbours.areas @ np.abs(neighbours.normals))
