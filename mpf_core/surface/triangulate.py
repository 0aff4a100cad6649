"""Marching cubes over the cells that the refinement kept, vertices shared, each on a root of θ."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from mpf_core.parallel import mapped
from mpf_core.surface import cubes
from mpf_core.surface.lattice import Cells, Flat, Lattice, blocks
from mpf_core.surface.refine import signs

# The next step of false position is not worth an evaluation when it is shorter than this share of
# a cell: the secant's slope is good to some percent, so the root is then good to a thousandth.
TOLERANCE = 0.02
ROUNDS = 8
CLEARANCE = 1e-3  # from the edge's ends: a vertex on a grid vertex makes triangles of no area

Floats = NDArray[np.float64]
Theta = Callable[[Floats, NDArray[np.int64]], Floats]  # at shares of the edges of these numbers


@dataclass(frozen=True)
class Triangles:
    """vertices: (v, 3) normalised; faces: (f, 3) counter-clockwise seen from θ > 0; crossed: cells
    with both signs at their corners."""

    vertices: Floats
    faces: NDArray[np.int64]
    crossed: int


def triangulated(lattice: Lattice, cells: Cells) -> Triangles:
    """The zero level of θ in cells (m, 3) of size 2; their vertices must be known."""
    cut = np.zeros((3, len(lattice.values)), dtype=bool)  # the edge that begins there along an axis

    def edges_of(rows: slice) -> tuple[Flat, int]:
        at, bits = signs(lattice, cells[rows])
        _mark(cut, at, bits)
        return _cut_edges(at, bits)

    corners, crossed = zip(*mapped(edges_of, blocks(len(cells))), strict=True)
    marks = cut[0].view(np.uint8) | cut[1].view(np.uint8) << 1 | cut[2].view(np.uint8) << 2
    start = np.flatnonzero(marks)
    owned = marks[start]
    first = np.empty(len(lattice.values), dtype=np.int32)  # where there is a mark
    first[start] = np.cumsum(_COUNT[owned]) - _COUNT[owned]
    faces = mapped(partial(_numbers, first, marks), corners)
    row, axis = np.nonzero(_BITS[owned].astype(bool))
    start = start[row]
    roots = mapped(lambda rows: _rooted(lattice, start[rows], axis[rows]), blocks(len(start)))
    lattice.evaluations += sum(count for _, count in roots)
    vertices = np.concatenate([found for found, _ in roots])
    return Triangles(vertices, np.concatenate(faces), sum(crossed))


# By mark: how many edges begin at the vertex, and how many of them come before each axis.
_BITS = np.array([[mark >> axis & 1 for axis in range(3)] for mark in range(8)])
_COUNT = _BITS.sum(1)
_BEFORE = (np.cumsum(_BITS, axis=1) - _BITS).ravel()
# Places of the 27 vertices of a cell of size 2: (8 children, 8 corners).
_PLACES = (cubes.CORNERS[:, None] + cubes.CORNERS[None]) @ np.array([1, 3, 9])


def _mark(cut: NDArray[np.bool_], at: Flat, bits: NDArray[np.uint32]) -> None:
    """Mark the edges in cells of size 2 whose ends differ in sign."""
    for axis in range(3):
        differ = bits ^ bits >> np.uint32(3**axis)
        for place in range(27):
            if place // 3**axis % 3 < 2:
                cut[axis, at[place, (differ & np.uint32(1 << place)) != 0]] = True


def _cut_edges(at: Flat, bits: NDArray[np.uint32]) -> tuple[Flat, int]:
    """(f, 3) edges at the corners of the triangles in cells of size 2, as 4 · lower vertex + axis,
    and the number of finest cells that are crossed."""
    counts, edges = cubes.table()
    found, crossed = [], 0
    for places in _PLACES:
        pattern = np.zeros(len(bits), dtype=np.uint8)
        for corner, place in enumerate(places):
            pattern |= ((bits & np.uint32(1 << place)) != 0).view(np.uint8) << corner
        row = np.flatnonzero((pattern > 0) & (pattern < 255))
        crossed += len(row)
        pattern = pattern[row]
        each = counts[pattern]
        number = np.arange(each.sum()) - np.repeat(np.cumsum(each) - each, each)
        edge = edges[np.repeat(pattern, each), number]  # (f, 3)
        lower = at[places[cubes.EDGE_LOWER][edge], np.repeat(row, each)[:, None]]
        found.append(lower << 2 | cubes.EDGE_AXIS[edge])
    return np.concatenate(found), crossed


def _numbers(first: NDArray[np.int32], marks: NDArray[np.uint8], edges: Flat) -> Flat:
    """(f, 3) vertex numbers of edges: in the order of their lower vertex, then of their axis."""
    lower = edges >> 2
    before = _BEFORE[marks[lower] * 3 + (edges & 3)]
    numbers: Flat = first[lower] + before
    return numbers


def _rooted(lattice: Lattice, start: Flat, axis: NDArray[np.int64]) -> tuple[Floats, int]:
    """(v, 3) positions of the roots on the edges that begin at `start` along `axis`, and how often
    θ was evaluated."""
    low = lattice.vertices(start)
    along = np.eye(3, dtype=np.int64)[axis]
    above = lattice.values[lattice.index(low + along, (0,))[0]].astype(np.float64)
    below = lattice.values[start].astype(np.float64)
    origin, step = lattice.grid.points(low), along * lattice.grid.steps
    asked: list[int] = []

    def theta(share: Floats, among: NDArray[np.int64]) -> Floats:
        asked.append(len(among))
        at = origin[among] + share[:, None] * step[among]
        return lattice.evaluate(at).astype(np.float64)

    share = _roots(below, above, theta)
    roots: Floats = origin + share[:, None] * step
    return roots, sum(asked)


def _roots(below: Floats, above: Floats, theta: Theta) -> Floats:
    """Where θ is zero along each edge, as a share of it, from its values at the ends.

    Each edge is evaluated at least once, at the zero of its secant; the next guess is that of the
    parabola through all three points, or the middle where a crease lies between them.
    """
    left, right = _Points.at(0.0, below), _Points.at(1.0, above)
    share = _secant(left, right)
    among = np.arange(len(share))
    for _ in range(ROUNDS):
        value = theta(share[among], among)
        lower = (value < 0) == (left.value < 0)
        here = _Points(share[among], value)
        third = left.where(lower, right)
        left, right = here.where(lower, left), right.where(lower, here)
        bent = _bent(left, right, here, third)
        better = np.where(bent, (left.share + right.share) / 2, _parabola(left, right, third))
        share[among] = better
        again = np.abs(better - here.share) > TOLERANCE
        if not again.any():
            break
        among, left, right = among[again], left.only(again), right.only(again)
    clear: Floats = np.clip(share, CLEARANCE, 1 - CLEARANCE)
    return clear


@dataclass(frozen=True)
class _Points:
    """(m,) places on the edges, as a share of them, and θ there."""

    share: Floats
    value: Floats

    @classmethod
    def at(cls, share: float, value: Floats) -> _Points:
        return cls(np.full(len(value), share), value)

    def where(self, mine: NDArray[np.bool_], other: _Points) -> _Points:
        """These points where `mine`, the others elsewhere."""
        share = np.where(mine, self.share, other.share)
        return _Points(share, np.where(mine, self.value, other.value))

    def only(self, these: NDArray[np.bool_]) -> _Points:
        return _Points(self.share[these], self.value[these])


def _secant(left: _Points, right: _Points) -> Floats:
    width = left.value - right.value
    flat = width == 0  # both are zero
    part = np.where(flat, 0.5, left.value / np.where(flat, 1, width))
    share: Floats = left.share + (right.share - left.share) * part
    return share


def _bent(left: _Points, right: _Points, here: _Points, third: _Points) -> NDArray[np.bool_]:
    """Where the slope changes twofold at the newest point: the parabola would not help."""
    one = np.abs((right.value - left.value) * (here.share - third.share))
    two = np.abs((here.value - third.value) * (right.share - left.share))
    bent: NDArray[np.bool_] = np.maximum(one, two) > 2 * np.minimum(one, two)
    return bent


def _parabola(left: _Points, right: _Points, third: _Points) -> Floats:
    """Zero between left and right of the parabola share(θ) through three points, or the secant's
    where it has none there."""
    total = np.zeros_like(left.share)
    trio = (left, right, third)
    with np.errstate(all="ignore"):
        for k in range(3):
            one, two = trio[k - 1], trio[k - 2]
            top = trio[k].share * one.value * two.value
            total += top / ((trio[k].value - one.value) * (trio[k].value - two.value))
        inside = (total > left.share) & (total < right.share)
    return np.where(inside, total, _secant(left, right))
