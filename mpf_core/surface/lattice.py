"""θ at the grid's vertices, kept in bricks that exist only where the surface passes.

A vertex is an integer triple on the finest grid. A table over all brick places leads to the number
of a brick, so that finding a vertex is arithmetic and one look-up: nothing is sorted or searched.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mpf_core.parallel import mapped

SPAN = 8  # finest cells along a side of a brick
CHUNK = 16_384  # cells handled at once, so that tables over their vertices stay in the cache

Evaluate = Callable[[NDArray[np.float64]], NDArray[np.float32]]
Cells = NDArray[np.int64]
Flat = NDArray[np.int64]


@dataclass(frozen=True)
class Grid:
    """Cells from `origin` (3,), `shape` (3,) of them at the finest level.

    cell: edge along an axis that is not refined; finer: (3,) how many times finer the cells are
    along each axis; levels: halvings between the coarsest cells looked at and the finest, 0 to
    look everywhere. `shape` is a multiple of SPAN and of 2 ** levels.
    """

    origin: NDArray[np.float64]
    cell: float
    shape: NDArray[np.int64]
    levels: int
    finer: NDArray[np.int64] = field(default_factory=lambda: np.ones(3, dtype=np.int64))

    @classmethod
    def around(
        cls,
        low: NDArray[np.float64],
        high: NDArray[np.float64],
        resolution: int,
        finer: tuple[int, int, int] = (1, 1, 1),
    ) -> Grid:
        """Cells over the box, `resolution` of them along its longest side before `finer`."""
        cell = float((high - low).max()) / resolution
        # 16 to 32 coarsest cells a side: few enough to be cheap, enough to see what is there.
        levels = min(4, int(np.log2(resolution / 8))) + max(0, int(np.log2(resolution / 512)))
        block = max(2**levels, SPAN)
        steps = cell / np.array(finer)
        shape = -(-np.ceil((high - low) / steps).astype(np.int64) // block) * block
        return cls((low + high) / 2 - shape * steps / 2, cell, shape, levels, np.array(finer))

    @property
    def steps(self) -> NDArray[np.float64]:
        """(3,) edges of the finest cells."""
        return self.cell / self.finer

    def points(self, vertices: NDArray[np.integer]) -> NDArray[np.float64]:
        """Normalised position of finest-grid vertices (m, 3)."""
        return self.origin + vertices * self.steps


class Lattice:
    """θ at the vertices of bricks; NaN where it is not known.

    spacing: finest cells between the vertices that are kept, a divisor of SPAN; everywhere: whether
    all bricks exist from the start. Tables over the vertices of m cells have the shape (·, m): a
    cell is a column, so that numpy's inner loops are long.
    """

    def __init__(self, grid: Grid, evaluate: Evaluate, spacing: int, *, everywhere: bool):
        self.grid, self.evaluate, self.spacing = grid, evaluate, spacing
        self.bits = (SPAN // spacing).bit_length() - 1  # of a vertex's place along a brick's side
        self.shape = grid.shape // SPAN + 1  # brick places along each axis
        self.evaluations = 0
        self.places = np.empty(0, dtype=np.int64)
        self.lowest = np.empty((0, 3), dtype=np.int64)  # vertex of each brick
        self.numbers = np.full(int(np.prod(self.shape)), -1, dtype=np.int32)
        self.values = np.empty(0, dtype=np.float32)
        if everywhere:
            self._add(np.arange(len(self.numbers)))

    def finer(self, cells: Cells, size: int) -> Lattice:
        """The lattice of half the spacing in those bricks alone in which cells (m, 3) of `size`
        finest cells have vertices, with all that is known there. The bricks must exist."""
        fine = Lattice(self.grid, self.evaluate, self.spacing // 2, everywhere=False)
        fine.evaluations = self.evaluations
        fine.hold(cells, size)
        known = SPAN // self.spacing
        half = fine.values.reshape(-1, known, 2, known, 2, known, 2)
        of_brick = self.values.reshape(-1, known, known, known)
        half[:, :, 0, :, 0, :, 0] = of_brick[self.numbers[fine.places]]
        return fine

    def index(self, cells: Cells, offsets: tuple[int, ...]) -> Flat:
        """(len(offsets)³, m) places in `values` of the vertices at cells (m, 3) plus offsets along
        each axis, x fastest. Their bricks must exist."""
        place, inner = self._address(cells, offsets)
        at = self.numbers[place].astype(np.int64)
        at <<= 3 * self.bits
        at += inner
        return at.reshape(len(offsets) ** 3, len(cells))

    def corners(self, cells: Cells, size: int) -> NDArray[np.float32]:
        """(8, m) θ at the corners of cells (m, 3) of `size` finest cells."""
        return self.values[self.index(cells, (0, size))]

    def vertices(self, at: Flat) -> Cells:
        """The finest-grid vertices (m, 3) at places in `values`."""
        vertices: Cells = self.lowest[at >> 3 * self.bits]
        if self.bits:
            mask = (1 << self.bits) - 1
            for axis in range(3):
                vertices[:, axis] += (at >> axis * self.bits & mask) * self.spacing
        return vertices

    def hold(self, cells: Cells, size: int) -> None:
        """Make the bricks in which cells (m, 3) of `size` finest cells have vertices."""
        touched = np.zeros(len(self.numbers), dtype=bool)

        def touch(rows: slice) -> None:
            touched[self._address(cells[rows], (0, size))[0]] = True

        mapped(touch, blocks(len(cells)))
        self._add(np.flatnonzero(touched & (self.numbers < 0)))

    def has(self, cells: Cells) -> NDArray[np.bool_]:
        """Whether the brick at the lowest vertex of each cell exists."""
        place, _ = self._address(cells, (0,))
        return self.numbers[place.ravel()] >= 0

    def learn(self, cells: Cells, offsets: tuple[int, ...]) -> None:
        """Evaluate θ where it is unknown at the vertices of cells (m, 3)."""
        wanted = np.zeros(len(self.values), dtype=bool)

        def want(rows: slice) -> None:
            wanted[self.index(cells[rows], offsets)] = True

        mapped(want, blocks(len(cells)))
        at = np.flatnonzero(wanted)
        self.renew(at[np.isnan(self.values[at])])

    def renew(self, at: Flat) -> None:
        """Evaluate θ at distinct places in `values`, whatever they hold."""

        def evaluated(rows: slice) -> None:
            self.values[at[rows]] = self.evaluate(self.grid.points(self.vertices(at[rows])))

        mapped(evaluated, blocks(len(at)))
        self.evaluations += len(at)

    def _address(self, cells: Cells, offsets: tuple[int, ...]) -> tuple[Flat, Flat]:
        """Brick places and places in the brick, with axes z, y, x, cell."""
        stride = (int(self.shape[1] * self.shape[2]), int(self.shape[2]), 1)
        views = ((None, None), (None, slice(None), None), (slice(None), None, None))
        place = np.zeros((1, 1, 1, len(cells)), dtype=np.int64)
        inner = np.zeros((1, 1, 1, len(cells)), dtype=np.int64)
        for axis, view in enumerate(views):
            v = cells[:, axis] + np.array(offsets)[:, None]  # (c, m)
            place = place + (v // SPAN * stride[axis])[view]
            inner = inner + (v % SPAN // self.spacing << axis * self.bits)[view]
        return place, inner

    def _add(self, places: Flat) -> None:
        if not len(places):
            return
        self.numbers[places] = np.arange(len(self.places), len(self.places) + len(places))
        self.places = np.concatenate([self.places, places])
        self.lowest = np.stack(np.unravel_index(self.places, self.shape), axis=-1) * SPAN
        fresh = np.full(len(places) << 3 * self.bits, np.nan, dtype=np.float32)
        self.values = np.concatenate([self.values, fresh])


def blocks(count: int) -> Iterator[slice]:
    """Slices of at most CHUNK rows that cover `count`; one empty slice if there are none."""
    for start in range(0, max(count, 1), CHUNK):
        yield slice(start, start + CHUNK)
