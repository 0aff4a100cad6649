"""How long the way from the fitted field to the written mesh will take: told before the field is
fitted, so that the fit leaves time for it, and again once its surface is seen, which may be more.

By counts: cells that the surface will cross, triangles that will be left. These follow from its
area, those from its shadows along the axes, and both from the samples. What each costs is told in
evaluations of θ, which are products of matrices, and in searches of a tree, which stand for all
other work: machines are fast at the one or the other, and the pace of both is measured.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mpf_core.cloud.neighbors import Neighborhoods, nearest
from mpf_core.field.footprint import Footprint
from mpf_core.options import SurfaceOptions
from mpf_core.progress import Clock
from mpf_core.surface.coarsen import faces_for, most_faces
from mpf_core.surface.resolution import Fineness, choose_resolution

# Evaluations and searches for each crossed cell (to find it, to merge its triangles) and for each
# triangle that is left (the last step, normals, crossings, report, writing).
EVALUATIONS = {"cell": 4.0, "face": 1.5}
SEARCHES = {"cell": 10.6, "face": 21.0}
FIXED = 1.5  # seconds
PROBES, ROUNDS = 16_384, 3  # at which a pace is measured, and how often; the best counts
NEIGHBOURS = 8  # that a search is for, among the probes
# A surface of so many times the cells that the samples foretell is torn, or full of pockets, and
# every one of them takes so many times as long: much to be closed, merged and taken back.
TORN, DEARER = 1.5, 1.6
LATE = 0.25  # of its seconds that an extraction may be foretold to last beyond the end
# Searches for each triangle after the last step; and seconds that this step, without which the mesh
# is ten times farther off, may last beyond the end.
AFTER, GRACE = 5.0, 2.0

Evaluate = Callable[[NDArray[np.float64]], NDArray[np.float32]]


@dataclass(frozen=True)
class Pace:
    """Seconds that an evaluation of θ takes, and a search in a tree, on the caller's threads."""

    evaluation: float
    search: float

    def of(self, what: str, count: float) -> float:
        """Seconds for so many cells or faces."""
        each = EVALUATIONS[what] * self.evaluation + SEARCHES[what] * self.search
        return each * count


@dataclass(frozen=True)
class Forecast:
    """What the samples tell of a mesh with `footprint`: its `area`, and its `shadows` (3,) along
    the axes, normalised; and the machine's `pace`."""

    options: SurfaceOptions
    footprint: Footprint
    area: float
    shadows: NDArray[np.float64]
    pace: Pace

    @property
    def fineness(self) -> Fineness:
        """Of the grid, if there is time for it."""
        return choose_resolution(self.options, self.footprint)

    def cells(self, fineness: Fineness) -> float:
        """How many of the grid's cells the surface will cross."""
        return crossed(self.shadows, 2 / fineness.cells / np.array(fineness.finer))

    def seconds(self, fineness: Fineness, cells: float | None = None) -> float:
        """From extraction to the written file, if the surface crosses so many `cells`."""
        expected = self.cells(fineness)
        more = 1.0 if cells is None else cells / expected
        cells = expected * more
        faces = 2 * cells
        if self.options.coarsen == "auto" and self.options.resolution is None:
            most = most_faces(self.options)
            faces = min(faces, faces_for(self.area * more, self.footprint.spacing, most))
        dearer = DEARER if more > TORN else 1.0
        return FIXED + dearer * (self.pace.of("cell", cells) + self.pace.of("face", faces))


@dataclass(frozen=True)
class Until:
    """The `end`, by `clock`, of what `forecast` is of."""

    forecast: Forecast
    clock: Clock
    end: float

    def fits(self, fineness: Fineness, cells: float) -> bool:
        """Whether there is time for a surface that crosses so many cells."""
        seconds = self.forecast.seconds(fineness, cells)
        return self.clock() + (1 - LATE) * seconds <= self.end

    def after(self, share: float) -> float:
        """When a share of the time left will have gone; past once the end is."""
        now = self.clock()
        return now + share * (self.end - now)

    def last_step(self, faces: int) -> float:
        """When the last step of a mesh of so many faces must have ended."""
        return self.end + GRACE - AFTER * self.forecast.pace.search * faces


def pace_of(evaluate: Evaluate, clock: Clock, threads: int = -1) -> Pace:
    """The machine's, on so many threads; `evaluate` is a field's θ."""
    points = np.random.default_rng(0).uniform(-1, 1, (PROBES, 3))

    def search() -> None:
        nearest(cKDTree(points), points, NEIGHBOURS, threads)

    return Pace(_each(lambda: evaluate(points), clock), _each(search, clock))


def _each(work: Callable[[], object], clock: Clock) -> float:
    """Seconds for one of PROBES."""
    seconds = []
    for _ in range(ROUNDS):
        begin = clock()
        work()
        seconds.append(clock() - begin)
    return min(seconds) / PROBES


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
