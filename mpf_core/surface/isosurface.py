"""The zero level of θ, coarse to fine: only cells that can hold the surface are ever looked at.

{φ = 0} = {θ = 0} (Proposition 1), so the phase head alone is evaluated. All lengths are normalised.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mpf_core.cloud.neighbors import distance_within
from mpf_core.errors import Cancelled, NoSurface, ResolutionTooHigh
from mpf_core.heeding import heed
from mpf_core.progress import CancelCheck
from mpf_core.surface.lattice import Cells, Evaluate, Grid
from mpf_core.surface.refine import refined
from mpf_core.surface.triangulate import triangulated

MEMORY_LIMIT = 3 * 2**30  # bytes
# Peak per crossed cell of all that follows: 817 at 1000³ where triangles are merged; extraction
# itself takes 408.
BYTES_PER_CELL = 850
# Share of the finest cells in the candidates of a size that are crossed. The large ones are there
# because of samples nearby and of the bounds' safety; to refuse what would fit is worse than to
# look one level further.
CROSSED = {2: 0.85, 4: 0.3}
CROSSED_OF_LARGE = 0.12
FINEST_CROSSED = 4  # finest cells that a surface crosses for each one of twice the size

__all__ = ["Grid", "Isosurface", "TooManyCells", "extract"]

Fits = Callable[[float], bool]


class TooManyCells(Exception):
    """The surface crosses more `cells` than `fits`; whoever asked takes a coarser grid."""

    def __init__(self, cells: float):
        super().__init__(f"the surface crosses some {cells:.0f} cells")
        self.cells = cells


@dataclass(frozen=True)
class Isosurface:
    """Triangles in the normalised frame, with what the extraction cost.

    vertices: (v, 3) float64; faces: (f, 3) counter-clockwise seen from θ > 0; evaluations: of θ,
    those on the edges included; crossed_cells: finest cells with both signs at their corners;
    ended_at_sides: whether it left the grid and was closed there.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    grid: Grid
    evaluations: int
    crossed_cells: int
    ended_at_sides: bool = False


def extract(
    evaluate: Evaluate,
    grid: Grid,
    samples: cKDTree,
    *,
    reach: float,
    memory_limit: int = MEMORY_LIMIT,
    fits: Fits | None = None,
    cancel: CancelCheck | None = None,
) -> Isosurface:
    """The zero level of `evaluate` (n, 3) → (n,), negative inside.

    No cell within `reach` of a sample is left out while cells are as large as a brick and as
    `reach`: there a fit is least to be trusted to keep to the bounds. `fits` says whether there is
    time for so many crossed cells. Raises NoSurface, ResolutionTooHigh, TooManyCells, Cancelled.
    """

    def near(cells: Cells, size: int) -> NDArray[np.bool_]:
        edges = grid.steps * size
        if edges.max() < reach:
            return np.zeros(len(cells), dtype=bool)
        within = float(np.linalg.norm(edges)) / 2 + reach
        return np.isfinite(distance_within(samples, grid.points(cells) + edges / 2, within))

    def check(count: int, size: int) -> None:
        heed()
        if cancel is not None and cancel():
            raise Cancelled("the extraction was cancelled")
        _check_memory(count, size, grid, memory_limit)

    meet = None if fits is None else partial(_check_time, fits)
    lattice, cells = refined(grid, evaluate, near, check, meet)
    found = triangulated(lattice, cells)
    if not found.crossed:
        raise NoSurface(
            "the field has no zero level in the box",
            advice="Fit for longer, or with another seed.",
        )
    return Isosurface(found.vertices, found.faces, grid, lattice.evaluations, found.crossed)


def _check_memory(count: int, size: int, grid: Grid, limit: int) -> None:
    # Each halving of the cells multiplies those near a surface by four.
    needed = count * size**2 * CROSSED.get(size, CROSSED_OF_LARGE) * BYTES_PER_CELL
    if needed > limit:
        longest = int((grid.shape // grid.finer).max())
        fits = int(longest * (limit / needed) ** 0.5)
        raise ResolutionTooHigh(
            f"the grid of {longest} cells needs about {needed / 2**30:.1f} GiB",
            where="resolution",
            advice=f"The largest that fits is about {fits}.",
        )


def _check_time(fits: Fits, count: int) -> None:
    crossed = FINEST_CROSSED * count
    if not fits(crossed):
        raise TooManyCells(crossed)
