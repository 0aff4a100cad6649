"""A partition of unity over space: smooth weights of the two sides of every cut, multiplied.

Cuts across an axis halve space again and again; a leaf is a tile. At a cut the weight of one side
falls from 1 to 0 within `half` to either side of its plane and the other's rises, so the products
along the paths to the leaves add up to exactly 1 everywhere, with two continuous derivatives.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Rows = NDArray[np.int64]


@dataclass(frozen=True)
class Cut:
    """The plane where coordinate `axis` is `at`, with the ramp `half` to either side.

    low, high: what lies below and above: the number of a later cut, or −1 − t for tile t
    """

    axis: int
    at: float
    half: float
    low: int
    high: int


@dataclass(frozen=True)
class Share:
    """A tile's part in some points: their `rows` (m,) and its `weights` (m,) > 0 there."""

    tile: int
    rows: Rows
    weights: Array


@dataclass(frozen=True)
class Partition:
    """`tiles` leaves under `cuts`, the first of which is the root; no cuts for a single tile."""

    cuts: tuple[Cut, ...]
    tiles: int

    def shares(self, x: Array) -> list[Share]:
        """The tiles that have weight at points x (n, 3), by their number; the weights at a point
        add up to 1."""
        rows, ones = np.arange(len(x)), np.ones(len(x))
        found: list[Share] = []
        todo = [(0 if self.cuts else -1, rows, ones)]
        while todo:
            node, rows, weights = todo.pop()
            if not len(rows):
                continue
            if node < 0:
                found.append(Share(-1 - node, rows, weights))
                continue
            cut = self.cuts[node]
            above = smooth_ramp((x[rows, cut.axis] - cut.at) / cut.half)
            for child, part in ((cut.low, 1 - above), (cut.high, above)):
                has = part > 0
                todo.append((child, rows[has], weights[has] * part[has]))
        return sorted(found, key=lambda share: share.tile)

    def boxes(self, box: Array, beyond: float = 0.0) -> Array:
        """(tiles, 2, 3) of each tile the corners of its part of `box` (2, 3), ramps included where
        `beyond` is 1 (its support), left out where it is 0 (its core)."""
        out = np.empty((self.tiles, 2, 3))
        todo = [(0 if self.cuts else -1, np.array(box, dtype=np.float64))]
        while todo:
            node, part = todo.pop()
            if node < 0:
                out[-1 - node] = part
                continue
            cut = self.cuts[node]
            low, high = part.copy(), part.copy()
            low[1, cut.axis] = min(part[1, cut.axis], cut.at + beyond * cut.half)
            high[0, cut.axis] = max(part[0, cut.axis], cut.at - beyond * cut.half)
            todo += [(cut.low, low), (cut.high, high)]
        return out


def smooth_ramp(t: Array) -> Array:
    """0 below −1, 1 above 1, and between a quintic with two continuous derivatives; odd about ½, so
    that the ramps of both sides add up to 1."""
    s = np.clip(0.5 * (t + 1), 0, 1)
    return np.asarray(s * s * s * (10 + s * (6 * s - 15)))
