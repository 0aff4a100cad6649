"""Marching cubes (Lorensen and Cline 1987) over a list of cells, with a table made from its rule.

Every face of a cell is decided from its own four corner signs alone: its cut edges are joined so
that negative corners are kept apart where the signs alternate. Two cells that share a face
therefore agree on it, and the surface is closed for every pattern of signs. The joined cut edges
form loops, which are triangulated without using a diagonal inside a face where that can be
avoided, since the cell behind that face might use the same one.

Corner c of a cell sits at (c & 1, c >> 1 & 1, c >> 2 & 1).
"""

from __future__ import annotations

from functools import cache, partial

import numpy as np
from numpy.typing import NDArray

CORNERS = np.array([[c & 1, c >> 1 & 1, c >> 2 & 1] for c in range(8)])
# Edges as (lower corner, upper corner); the axis is the bit in which they differ.
EDGES = tuple((c, c | 1 << axis) for axis in range(3) for c in range(8) if not c >> axis & 1)
EDGE_LOWER = np.array([low for low, _ in EDGES])
EDGE_UPPER = np.array([high for _, high in EDGES])
EDGE_AXIS = np.array([(high - low).bit_length() - 1 for low, high in EDGES])

Triangle = tuple[int, int, int]

_EDGE_OF = {frozenset(edge): number for number, edge in enumerate(EDGES)}


def _face_rings() -> list[tuple[int, int, int, int]]:
    """The corners of each face, counter-clockwise seen from outside the cell."""
    rings = []
    for axis in range(3):
        u, v = 1 << (axis + 1) % 3, 1 << (axis + 2) % 3
        low = (0, u, u | v, v)  # counter-clockwise seen from +axis
        rings.append(tuple(c | 1 << axis for c in low))
        rings.append(tuple(reversed(low)))
    return rings  # type: ignore[return-value]


def _segments(negative: list[bool]) -> dict[int, int]:
    """Directed cut-edge pairs over all faces, negative corners on the right seen from outside."""
    following: dict[int, int] = {}
    for ring in _face_rings():
        for i in range(4):
            corner, after = ring[i], ring[(i + 1) % 4]
            if not negative[corner] and negative[after]:
                # Walk back around the run of positive corners that ends here.
                j = i
                while not negative[ring[(j - 1) % 4]]:
                    j -= 1
                start, before = ring[j % 4], ring[(j - 1) % 4]
                cut_in = _EDGE_OF[frozenset((start, before))]
                following[_EDGE_OF[frozenset((corner, after))]] = cut_in
    return following


def _loops(following: dict[int, int]) -> list[list[int]]:
    loops, left = [], dict(following)
    while left:
        edge = next(iter(left))
        loop = []
        while edge in left:
            loop.append(edge)
            edge = left.pop(edge)
        loops.append(loop)
    return loops


def _in_one_face(a: int, b: int) -> bool:
    corners = [*EDGES[a], *EDGES[b]]
    return any(len({c >> axis & 1 for c in corners}) == 1 for axis in range(3))


def _triangulations(loop: list[int]) -> list[list[Triangle]]:
    if len(loop) < 3:
        return [[]]
    first, last = loop[0], loop[-1]
    found = []
    for i in range(1, len(loop) - 1):
        found += [
            [*left, (first, loop[i], last), *right]
            for left in _triangulations(loop[: i + 1])
            for right in _triangulations(loop[i:])
        ]
    return found


def _cost(loop: list[int], triangles: list[Triangle]) -> int:
    """How many sides lie inside a face without being one of the loop's own."""
    rim = {frozenset((loop[i - 1], loop[i])) for i in range(len(loop))}
    sides = {frozenset((t[i - 1], t[i])) for t in triangles for i in range(3)}
    return sum(_in_one_face(*side) for side in sides - rim)


@cache
def table() -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(256,) triangles per pattern and (256, most, 3) cut edges of each; bit c set: corner c < 0.

    Triangles are counter-clockwise seen from the positive side.
    """
    rows: list[list[Triangle]] = []
    for pattern in range(256):
        negative = [bool(pattern >> c & 1) for c in range(8)]
        triangles: list[Triangle] = []
        for loop in _loops(_segments(negative)):
            triangles += min(_triangulations(loop), key=partial(_cost, loop))
        rows.append(triangles)
    counts = np.array([len(row) for row in rows])
    edges = np.full((256, int(counts.max()), 3), -1)
    for pattern, row in enumerate(rows):
        if row:
            edges[pattern, : len(row)] = row
    return counts, edges


def patterns(values: NDArray[np.float32]) -> NDArray[np.int64]:
    """The sign pattern of each cell from its corner values (m, 8)."""
    bits: NDArray[np.int64] = ((values < 0) << np.arange(8)).sum(1)
    return bits
