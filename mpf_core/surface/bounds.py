"""Which signs the known values leave open. A sign is certain if one of two bounds says so:

- slope: a corner where |θ| = v keeps its sign within the distance v / slope. The slope is the
  steepest that the values known in the cell and around it in its parent show, at least the 1 that
  the Eikonal terms ask for, times SAFETY.
- prediction: the interpolated value is farther from zero than the interpolation was wrong one
  level up, times ERROR_SAFETY. Where θ is smooth the error falls to a quarter with each level;
  across the crease inside a thin wall it does not, but there the error seen one level up covers
  it, taken so many times.

Neither is proved, so the bound is heuristic. What it loses beside a found piece of surface is found
again (`refine.completed`); a whole piece is not.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from mpf_core.surface import cubes

SAFETY = 1.25
ERROR_SAFETY = 2.5
BOUND = (
    f"heuristic: a sign is taken as known where |θ| exceeds {SAFETY:g} times the slope seen around "
    f"the cell, or the interpolated θ {ERROR_SAFETY:g} times the error seen one level up"
)
CHILD_POINTS = 5  # points along a side of a cell at which its children's signs are asked for

CORNERS_OF_27 = (cubes.CORNERS * 2) @ np.array([1, 3, 9])

Corners = NDArray[np.float32]
Flags = NDArray[np.bool_]


@dataclass(frozen=True)
class Seen:
    """What the level above shows of each of m cells, from the vertices known of its parent.

    error: (m,) of the prediction from the parent's corners; slope: (m,)
    """

    error: Corners
    slope: Corners

    @classmethod
    def nothing(cls, count: int) -> Seen:
        """For cells without a parent."""
        return cls(np.full(count, np.inf, np.float32), np.zeros(count, np.float32))

    @classmethod
    def of(cls, values: Corners, edges: NDArray[np.float64]) -> Seen:
        """From (27, m) values in parents, NaN where unknown, at vertices `edges` (3,) apart."""
        off = np.abs(values - interpolated(values[CORNERS_OF_27], 3))
        return cls(np.fmax.reduce(off, axis=0, initial=0.0), steepness(values, edges))

    def __getitem__(self, rows: slice | NDArray[np.int64] | Flags) -> Seen:
        return Seen(self.error[rows], self.slope[rows])


def lattice_points(count: int) -> NDArray[np.float64]:
    """(count³, 3) points of the unit cell, x fastest."""
    line = np.linspace(0, 1, count)
    return np.array([(x, y, z) for z, y, x in product(line, repeat=3)])


def interpolated(corner: Corners, count: int) -> Corners:
    """(count³, m) trilinear interpolation at the points of cells from (8, m) at their corners.

    One axis after the other: a product of matrices would wake the threads of numpy's BLAS beside
    ours.
    """
    block = corner.reshape(2, 2, 2, -1)  # z, y, x, cell
    shares = np.linspace(0, 1, count, dtype=np.float32)
    for axis in (2, 1, 0):
        low, high = block.take(0, axis), block.take(1, axis)
        shape = (*block.shape[:axis], count, *block.shape[axis + 1 :])
        block = np.empty(shape, dtype=np.float32)
        for at, share in zip(np.moveaxis(block, axis, 0), shares, strict=True):
            np.multiply(low, 1 - share, out=at)
            np.add(at, share * high, out=at)
    return block.reshape(count**3, -1)


def open_children(corner: Corners, edges: NDArray[np.float64], seen: Seen, *, exact: bool) -> Flags:
    """(8, m) children of each cell in which both signs are possible.

    corner: (8, m) θ at the corners; edges: (3,) of the cells; seen: one level up.
    exact: the points asked are all vertices that any finer cell has; otherwise half the diagonal
    between them is added to the distances.
    """
    maybe = undecided(corner, seen)
    wanted = np.zeros(corner.shape, dtype=bool)
    wanted[:, maybe] = _open_children(corner[:, maybe], edges, seen[maybe], exact)
    return wanted


def undecided(corner: Corners, seen: Seen) -> Flags:
    """(m,) cells in which the prediction alone leaves some sign open: it lies between the
    corners."""
    margin = np.float32(ERROR_SAFETY * 1.0001) * seen.error  # beyond what the sums are rounded by
    flags: Flags = (corner.min(0) <= margin) & (corner.max(0) >= -margin)
    return flags


def _open_children(corner: Corners, edges: NDArray[np.float64], seen: Seen, exact: bool) -> Flags:
    points = lattice_points(CHILD_POINTS)
    gap = 0.0 if exact else float(np.linalg.norm(edges)) / (CHILD_POINTS - 1)
    distance = _distances(points, edges, gap / 2)
    reach = _reaches(corner, edges, seen.slope)
    between = interpolated(corner, CHILD_POINTS)  # (p, m)
    margin = np.float32(ERROR_SAFETY) * seen.error
    negative = between <= margin
    positive = between >= -margin
    for c in range(8):
        negative &= reach[c] <= distance[c, :, None]
        positive &= -reach[c] <= distance[c, :, None]
    return _any_in_child(negative) & _any_in_child(positive)


def predicted(corner: Corners, edges: NDArray[np.float64], seen: Seen) -> tuple[Corners, Flags]:
    """(27, m) interpolated values at the vertices of cells of size 2, and whether their signs are
    certain. Arguments as for `open_children`."""
    distance = _distances(lattice_points(3), edges)
    reach = _reaches(corner, edges, seen.slope)
    between = interpolated(corner, 3)
    sure = np.abs(between) > np.float32(ERROR_SAFETY) * seen.error
    sign = np.where(between < 0, np.float32(-1), np.float32(1))
    for c in range(8):
        sure |= reach[c] * sign > distance[c, :, None]
    return between, sure


def steepness(values: Corners, edges: NDArray[np.float64]) -> Corners:
    """(m,) slope that values at the count³ vertices of cells show, NaN left out.

    values: (count³, m), x fastest; edges: (3,) between neighbouring vertices. The steepest along
    each axis, together as if they met in one point.
    """
    count = round(len(values) ** (1 / 3))
    block = values.reshape(count, count, count, values.shape[1])
    squared = np.zeros(values.shape[1], dtype=np.float32)
    for axis in range(3):
        slope = np.abs(np.diff(block, axis=2 - axis))
        steepest = np.fmax.reduce(slope, axis=(0, 1, 2), initial=0.0)
        squared += np.square(steepest / np.float32(edges[axis]))
    slope_of_cell: Corners = np.sqrt(squared)
    return slope_of_cell


def _reaches(corner: Corners, edges: NDArray[np.float64], slope: Corners) -> Corners:
    """(8, m) signed distance within which each corner's sign holds, in cells with (3,) edges."""
    steepest = SAFETY * np.maximum(np.maximum(slope, steepness(corner, edges)), 1)
    reach: Corners = (corner / steepest).astype(np.float32, copy=False)
    return reach


def _distances(
    points: NDArray[np.float64], edges: NDArray[np.float64], more: float = 0.0
) -> Corners:
    """(8, p) from each corner to each point of the cell, and `more`."""
    between = (cubes.CORNERS[:, None] - points[None]) * edges
    distance: Corners = (np.linalg.norm(between, axis=-1) + more).astype(np.float32)
    return distance


def _any_in_child(flags: Flags) -> Flags:
    """(8, m) whether any of a child's 3³ points of the cell's 5³ is set in flags (125, m)."""
    block = flags.reshape(CHILD_POINTS, CHILD_POINTS, CHILD_POINTS, -1)
    for axis in range(3):
        line = np.moveaxis(block, axis, 0)
        halves = (line[0] | line[1] | line[2], line[2] | line[3] | line[4])
        block = np.stack(halves, axis=axis)
    return block.reshape(8, -1)
