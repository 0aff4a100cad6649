"""How long the way from the fitted field to the written mesh will take, before the field is fitted.

By counts: cells that the surface will cross, triangles that will be left. Both follow from the
area, and that from the samples. What each costs is told in evaluations of θ, whose pace is
measured.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mpf_core.cloud.neighbors import SPACING_NEIGHBOUR, Neighborhoods
from mpf_core.field.footprint import Footprint
from mpf_core.options import SurfaceOptions
from mpf_core.surface.coarsen import faces_for
from mpf_core.surface.resolution import choose_resolution

CROSSED = 1.45  # cells of side 1 that a surface of area 1 crosses, for all directions alike
PER_CELL = 9.5  # evaluations per crossed cell: 4.1 of θ, the rest sorting, welding, merging
PER_FACE = 11.0  # for each triangle left: the last step, normals, crossings, report, writing
FIXED = 1.5  # seconds
PROBES, ROUNDS = 16_384, 4  # points at which the pace is measured, and how often; the best counts

Evaluate = Callable[[NDArray[np.float64]], NDArray[np.float32]]


def seconds_after_fit(
    options: SurfaceOptions,
    footprint: Footprint,
    area: float,
    evaluate: Evaluate,
    clock: Callable[[], float],
) -> float:
    """From extraction to the written file, for a mesh of `area`, normalised. `evaluate` need not be
    the field that is meant, only as large."""
    fineness = choose_resolution(options, footprint)
    cells = CROSSED * area * (fineness.cells / 2) ** 2 * max(fineness.finer)
    faces = 2 * cells
    if options.coarsen == "auto" and options.resolution is None:
        faces = min(faces, faces_for(area, footprint.spacing))
    points = np.random.default_rng(0).uniform(-1, 1, (PROBES, 3))
    seconds = []
    for _ in range(ROUNDS):
        begin = clock()
        evaluate(points)
        seconds.append(clock() - begin)
    pace = min(seconds) / PROBES
    return FIXED + pace * (PER_CELL * cells + PER_FACE * faces)


def area_of(neighbours: Neighborhoods, sheets: float) -> float:
    """Of the mesh around samples, of which a share `sheets` is of open sheets with two walls: each
    sample stands for a sixth of the disc out to its sixth neighbour."""
    own = np.pi / SPACING_NEIGHBOUR * float((neighbours.spacing**2).sum())
    return (1 + sheets) * own
