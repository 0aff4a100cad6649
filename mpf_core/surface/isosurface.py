"""The zero level of θ, coarse to fine: only cells that can hold the surface are ever looked at.

{φ = 0} = {θ = 0} (Proposition 1), so the phase head alone is evaluated. Starting from coarse cells,
a cell is split into eight while its corners differ in sign, or the smallest |θ| at its corners is
within reach of its half diagonal, or, at the coarse levels, a sample lies near. The reach assumes
|∇θ| ≥ 1 / SAFETY there, which the Eikonal terms ask for but do not prove: the bound is heuristic.

Cells are integer triples on the grid of their level; all lengths are normalised.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mpf_core.cloud.neighbors import distance_within
from mpf_core.errors import Cancelled, NoSurface, ResolutionTooHigh
from mpf_core.progress import CancelCheck
from mpf_core.surface import cubes

COARSEST = 16.0  # finest cells per coarsest cell: coarse enough to be cheap, fine enough to see
SAFETY = 1.25
MEMORY_LIMIT = 3 * 2**30  # bytes
BYTES_PER_CELL = 450  # peak of the evaluation of one level over its candidate cells
BITS = 20  # per coordinate in a vertex key: grids up to 2²⁰ cells a side

Evaluate = Callable[[NDArray[np.float64]], NDArray[np.float32]]
Cells = NDArray[np.int64]


@dataclass(frozen=True)
class Grid:
    """Cells of edge `cell` from `origin` (3,), `shape` (3,) of them at the finest level."""

    origin: NDArray[np.float64]
    cell: float
    shape: NDArray[np.int64]
    levels: int

    @classmethod
    def around(cls, low: NDArray[np.float64], high: NDArray[np.float64], resolution: int) -> Grid:
        """Cubic cells over the box, `resolution` of them along its longest side."""
        cell = float((high - low).max()) / resolution
        levels = max(0, min(4, int(np.log2(max(resolution / 8, 1)))))
        block = 2**levels
        shape = -(-np.ceil((high - low) / cell).astype(np.int64) // block) * block
        middle = (low + high) / 2
        return cls(middle - shape * cell / 2, cell, shape, levels)

    def points(self, vertices: Cells) -> NDArray[np.float64]:
        """Normalised position of finest-grid vertices (m, 3)."""
        return self.origin + vertices * self.cell


@dataclass(frozen=True)
class Isosurface:
    """Triangles in the normalised frame, with what the extraction cost.

    vertices: (v, 3) float64; faces: (f, 3) counter-clockwise seen from θ > 0.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    grid: Grid
    evaluations: int
    crossed_cells: int


class _Values:
    """θ at the finest-grid vertices evaluated so far, sorted by key."""

    def __init__(self, grid: Grid, evaluate: Evaluate):
        self.grid, self.evaluate = grid, evaluate
        self.keys = np.empty(0, dtype=np.int64)
        self.values = np.empty(0, dtype=np.float32)
        self.evaluations = 0

    def at_corners(self, cells: Cells, size: int) -> NDArray[np.float32]:
        """(m, 8) θ at the corners of cells given by their lowest finest-grid vertex."""
        keys = pack(cells)[:, None] + pack(cubes.CORNERS * size)[None]  # (m, 8)
        wanted, inverse = np.unique(keys, return_inverse=True)
        place = np.asarray(np.searchsorted(self.keys, wanted))
        known = np.asarray(place < len(self.keys))
        known[known] = self.keys[place[known]] == wanted[known]
        values = np.empty(len(wanted), dtype=np.float32)
        values[known] = self.values[place[known]]
        fresh = wanted[~known]
        values[~known] = self.evaluate(self.grid.points(unpack(fresh)))
        self.evaluations += len(fresh)
        # Only the vertices of this level can be corners of the next.
        self.keys, self.values = wanted, values
        corner: NDArray[np.float32] = values[inverse.reshape(keys.shape)]
        return corner


def pack(vertices: Cells) -> NDArray[np.int64]:
    """One sortable integer per grid vertex (m, 3); sums of keys are keys of sums."""
    return (vertices[..., 0] << 2 * BITS) + (vertices[..., 1] << BITS) + vertices[..., 2]


def unpack(keys: NDArray[np.int64]) -> Cells:
    """Inverse of `pack`."""
    mask = (1 << BITS) - 1
    return np.stack([keys >> 2 * BITS, keys >> BITS & mask, keys & mask], axis=-1)


def extract(
    evaluate: Evaluate,
    grid: Grid,
    samples: cKDTree,
    *,
    reach: float,
    memory_limit: int = MEMORY_LIMIT,
    cancel: CancelCheck | None = None,
) -> Isosurface:
    """The zero level of `evaluate` (n, 3) → (n,), negative inside.

    `reach` is the distance from the samples within which no cell is left out down to the last but
    one level. Raises NoSurface, ResolutionTooHigh, Cancelled.
    """
    values = _Values(grid, evaluate)
    size = 2**grid.levels
    ranges = [np.arange(0, n, size) for n in grid.shape]
    cells = np.stack(np.meshgrid(*ranges, indexing="ij"), -1).reshape(-1, 3)
    while True:
        if cancel is not None and cancel():
            raise Cancelled("the extraction was cancelled")
        corner = values.at_corners(cells, size)
        crossed = (corner < 0).any(1) & (corner >= 0).any(1)
        if size == 1:
            break
        half_diagonal = 0.5 * np.sqrt(3) * size * grid.cell
        keep = crossed | (np.abs(corner).min(1) <= SAFETY * half_diagonal)
        if size > 2:
            keep |= _near(samples, grid.points(cells) + size * grid.cell / 2, half_diagonal + reach)
        cells = _children(cells[keep], size // 2)
        size //= 2
        _check_memory(len(cells), size, grid, memory_limit)
    if not crossed.any():
        raise NoSurface(
            "the field has no zero level in the box",
            advice="Fit for longer, or with another seed.",
        )
    vertices, faces = _triangulate(cells[crossed], corner[crossed], grid, evaluate)
    evaluations = values.evaluations + len(vertices)
    return Isosurface(vertices, faces, grid, evaluations, int(crossed.sum()))


def _near(samples: cKDTree, centres: NDArray[np.float64], within: float) -> NDArray[np.bool_]:
    return np.isfinite(distance_within(samples, centres, within))


def _children(cells: Cells, size: int) -> Cells:
    children: Cells = (cells[:, None] + cubes.CORNERS[None] * size).reshape(-1, 3)
    return children


def _check_memory(count: int, size: int, grid: Grid, limit: int) -> None:
    # Each halving of the cells multiplies those near a surface by four.
    needed = count * 4 ** np.log2(size) * BYTES_PER_CELL
    if needed > limit:
        fits = int(grid.shape.max() * (limit / needed) ** 0.5)
        raise ResolutionTooHigh(
            f"the grid of {grid.shape.max()} cells needs about {needed / 2**30:.1f} GiB",
            where="resolution",
            advice=f"The largest that fits is about {fits}.",
        )


def _triangulate(
    cells: Cells, corner: NDArray[np.float32], grid: Grid, evaluate: Evaluate
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    counts, edges = cubes.table()
    pattern = cubes.patterns(corner)
    rows = np.repeat(np.arange(len(cells)), counts[pattern])
    first = np.repeat(np.cumsum(counts[pattern]) - counts[pattern], counts[pattern])
    number = np.arange(len(rows)) - first
    edge = edges[pattern[rows], number]  # (f, 3) edge of the cell at each triangle corner
    low, high = cubes.EDGE_LOWER[edge], cubes.EDGE_UPPER[edge]
    key = pack(cells[rows][:, None] + cubes.CORNERS[low]) * 3 + cubes.EDGE_AXIS[edge]
    unique, index, inverse = np.unique(key, return_index=True, return_inverse=True)
    at = np.repeat(rows, 3)[index]
    below = corner[at, low.ravel()[index]].astype(np.float64)
    above = corner[at, high.ravel()[index]].astype(np.float64)
    start = grid.points(unpack(unique // 3))
    step = np.eye(3)[unique % 3] * grid.cell
    t = _root(start, step, below, above, evaluate)
    return start + t[:, None] * step, inverse.reshape(-1, 3).astype(np.int64)


def _root(
    start: NDArray[np.float64],
    step: NDArray[np.float64],
    below: NDArray[np.float64],
    above: NDArray[np.float64],
    evaluate: Evaluate,
) -> NDArray[np.float64]:
    """Where θ is zero along each cut edge, as a share of it: false position, twice."""
    t = below / (below - above)
    value = evaluate(start + t[:, None] * step).astype(np.float64)
    same = (value < 0) == (below < 0)
    t0, v0 = np.where(same, t, 0.0), np.where(same, value, below)
    t1, v1 = np.where(same, 1.0, t), np.where(same, above, value)
    width = np.where(v0 == v1, 1.0, v0 - v1)
    refined = t0 + (t1 - t0) * np.where(v0 == v1, 0.5, v0 / width)
    # A vertex on a grid vertex would make triangles of no area.
    share: NDArray[np.float64] = np.clip(refined, 1e-3, 1 - 1e-3)
    return share
