"""Coarse to fine: from all coarse cells to the cells of two finest cells a side that the surface
passes, with the sign of θ known at each of their 27 vertices.

Cells are integer triples, their lowest vertex on the finest grid. Down to cells of two, θ is
evaluated at the corners of every cell in which both signs are possible. In the last step a vertex
is evaluated only if the corners around leave its sign open; elsewhere it keeps the interpolated
value, which has the right sign.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mpf_core.parallel import mapped
from mpf_core.surface import bounds, cubes
from mpf_core.surface.lattice import SPAN, Cells, Evaluate, Flat, Grid, Lattice, blocks

Near = Callable[[Cells, int], NDArray[np.bool_]]
Check = Callable[[int, int], None]
Meet = Callable[[int], None]

_MIDDLES = np.setdiff1d(np.arange(27), bounds.CORNERS_OF_27)


def refined(
    grid: Grid, evaluate: Evaluate, near: Near, check: Check, meet: Meet | None = None
) -> tuple[Lattice, Cells]:
    """The lattice and the cells (m, 3) of size 2 that may hold the surface.

    near(cells, size) tells which cells samples lie in or beside: they are split whatever θ says,
    while they are as large as a brick. check(count, size) is called with the cells of each level
    after the first, meet(count), if given, with those of size 2 that have both signs at their
    corners.
    """
    size = 2**grid.levels
    ranges = [np.arange(0, n, max(size, 2)) for n in grid.shape]
    cells = np.stack(np.meshgrid(*ranges, indexing="ij"), -1).reshape(-1, 3)
    lattice = Lattice(grid, evaluate, min(size, SPAN), everywhere=True)
    if size == 1:  # every vertex is asked for
        lattice.learn(cells, (0, 1, 2))
        return lattice, cells
    lattice.learn(cells, (0, size))
    seen = bounds.Seen.nothing(len(cells))
    while size > 2:
        cells, size = _children(lattice, cells, size, seen, near), size // 2
        check(len(cells), size)
        if size < SPAN:
            lattice = lattice.finer(_parents(cells, size), 2 * size)
        lattice.learn(cells, (0, size))
        seen = _seen(lattice, cells, size)
    if meet is not None:
        meet(_crossed(lattice, cells))
    lattice, cells = _last(lattice, cells, seen)
    return lattice, completed(lattice, cells)


def _parents(cells: Cells, size: int) -> Cells:
    """(m, 3) the cells of twice the size in which cells of `size` lie."""
    parents: Cells = cells // (2 * size) * (2 * size)
    return parents


def _children(lattice: Lattice, cells: Cells, size: int, seen: bounds.Seen, near: Near) -> Cells:
    """The children of cells of `size` in which both signs are possible."""
    edges = lattice.grid.steps * size
    beside = near(cells, size) if size >= SPAN else np.zeros(len(cells), dtype=bool)

    def children(rows: slice) -> Cells:
        part, rest = cells[rows], ~beside[rows]
        exact = size < bounds.CHILD_POINTS
        corner = lattice.corners(part[rest], size)
        wanted = np.ones((8, len(part)), dtype=bool)
        wanted[:, rest] = bounds.open_children(corner, edges, seen[rows][rest], exact=exact)
        row, child = np.nonzero(wanted.T)
        found: Cells = part[row] + cubes.CORNERS[child] * (size // 2)
        return found

    return np.concatenate(mapped(children, blocks(len(cells))))


def _seen(lattice: Lattice, cells: Cells, size: int) -> bounds.Seen:
    """What their parents show of cells (m, 3) of `size`; children of one parent in a row."""
    parent = _parents(cells, size)
    first = np.ones(len(cells), dtype=bool)
    first[1:] = (parent[1:] != parent[:-1]).any(1)
    parent = parent[first]

    def of_parents(rows: slice) -> bounds.Seen:
        values = lattice.values[lattice.index(parent[rows], (0, size, 2 * size))]
        return bounds.Seen.of(values, lattice.grid.steps * size)

    seen = mapped(of_parents, blocks(len(parent)))
    error = np.concatenate([one.error for one in seen])
    slope = np.concatenate([one.slope for one in seen])
    return bounds.Seen(error, slope)[np.cumsum(first) - 1]


def _crossed(lattice: Lattice, cells: Cells) -> int:
    """How many of the cells of size 2 have both signs at their corners."""

    def crossed(rows: slice) -> int:
        negative = lattice.corners(cells[rows], 2) < 0
        return int((negative.any(0) & ~negative.all(0)).sum())

    return sum(mapped(crossed, blocks(len(cells))))


def _last(lattice: Lattice, cells: Cells, seen: bounds.Seen) -> tuple[Lattice, Cells]:
    """The cells of size 2 in which both signs are possible, and a lattice in which all their
    vertices are known."""
    edges = lattice.grid.steps * 2

    def kept(rows: slice) -> tuple[Cells, bounds.Corners, bounds.Flags]:
        part, above = cells[rows], seen[rows]
        corner = lattice.corners(part, 2)
        maybe = bounds.undecided(corner, above)
        part, corner = part[maybe], corner[:, maybe]
        predicted, certain = bounds.predicted(corner, edges, above[maybe])
        crossed = (corner < 0).any(0) & (corner >= 0).any(0)
        keep = crossed | ~certain[_MIDDLES].all(0)
        return part[keep], predicted[_MIDDLES][:, keep], ~certain[_MIDDLES][:, keep]

    found = mapped(kept, blocks(len(cells)))
    cells = np.concatenate([part for part, _, _ in found])
    fine = lattice.finer(cells, 2)
    pending = np.zeros(len(fine.values), dtype=bool)
    sure = np.zeros(len(fine.values), dtype=bool)
    for part, predicted, open_ in found:
        at = fine.index(part, (0, 1, 2))[_MIDDLES]
        fine.values[at] = predicted
        pending[at[open_]] = True
        sure[at[~open_]] = True
    fine.renew(np.flatnonzero(pending & ~sure))
    return fine, cells


def completed(lattice: Lattice, cells: Cells) -> Cells:
    """The cells (m, 3) of size 2 and all beside them into which the surface goes on."""
    found = [cells]
    listed = np.zeros(len(lattice.values), dtype=bool)
    listed[lattice.index(cells, (0,))] = True
    while len(cells):
        cells = _beyond(lattice, cells)
        missing = np.ones(len(cells), dtype=bool)
        there = np.flatnonzero(lattice.has(cells))
        missing[there] = ~listed[lattice.index(cells[there], (0,))[0]]
        cells = np.unique(cells[missing], axis=0)
        if len(cells):
            lattice.hold(cells, 2)
            lattice.learn(cells, (0, 1, 2))
            listed = np.pad(listed, (0, len(lattice.values) - len(listed)))
            listed[lattice.index(cells, (0,))] = True
            found.append(cells)
    return np.concatenate(found)


def signs(lattice: Lattice, cells: Cells) -> tuple[Flat, NDArray[np.uint32]]:
    """(27, m) places of the vertices of cells of size 2, and a bit for each negative one (m,)."""
    at = lattice.index(cells, (0, 1, 2))
    negative = lattice.values[at] < 0
    bits = np.zeros(len(cells), dtype=np.uint32)
    for vertex in range(27):
        bits |= negative[vertex].astype(np.uint32) << np.uint32(vertex)
    return at, bits


def _beyond(lattice: Lattice, cells: Cells) -> Cells:
    """Neighbours (m, 3) in the grid across faces that the surface cuts."""

    def beyond(rows: slice) -> Cells:
        part, neighbours = cells[rows], []
        _, bits = signs(lattice, part)
        for axis, high in np.ndindex(3, 2):
            mask = _face_mask(axis, 2 * high)
            share = bits & mask
            beside = part[(share != 0) & (share != mask)]
            beside[:, axis] += 4 * high - 2
            inside = (beside[:, axis] >= 0) & (beside[:, axis] < lattice.grid.shape[axis])
            neighbours.append(beside[inside])
        return np.concatenate(neighbours)

    return np.concatenate(mapped(beyond, blocks(len(cells))))


def _face_mask(axis: int, at: int) -> np.uint32:
    return np.uint32(sum(1 << p for p in range(27) if p // 3**axis % 3 == at))
