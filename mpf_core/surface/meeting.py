"""The walk of `intersections` through its tree, compiled: pairs of triangles that may cross.

All of it stands in one file, because the compiler's cache looks no further for changes.
"""

# Loops over numpy arrays have no types that mypy could check: the compiler checks them.
# mypy: ignore-errors
from __future__ import annotations

from collections.abc import Callable, Iterator

import numba

from mpf_core.field.fused import compilation
from mpf_core.field.kernels import compiled

# Types of the arguments: D float64, I int64; with the number of dimensions.
FORM = "D2 I1 I2 i D3 I2 D2 D1 I2"

ROUNDED = 1e-12  # of a volume: more than its digits that depend on the order of operations

inline = numba.njit(nogil=True)


def compilations() -> Iterator[Callable[[], None]]:
    """What compiles, one after another, all of this that is not compiled yet."""
    if not candidates.signatures:
        yield compilation(candidates, FORM, None)


@inline
def _meet(boxes, a, b):
    """Whether two boxes of the tree have a point in common."""
    for axis in range(3):
        if boxes[a, axis] > boxes[b, 3 + axis] or boxes[b, axis] > boxes[a, 3 + axis]:
            return False
    return True


@inline
def _straddles(corners, planes, slack, plane, other):
    """Whether triangle `other` has vertices on both sides of that of `plane`."""
    above, below = False, False
    for k in range(3):
        height = -planes[plane, 3]
        for axis in range(3):
            height += corners[other, k, axis] * planes[plane, axis]
        above |= height > slack[plane]
        below |= height < -slack[plane]
    return above and below


@inline
def _common(faces, a, b):
    """How many vertices two triangles have in common, and the last of them among those of `b`."""
    count, last = 0, 0
    for i in range(3):
        for j in range(3):
            if faces[a, i] == faces[b, j]:
                count, last = count + 1, j
    return count, last


@inline
def _passes(corners, other, corner, triangle):
    """Whether the edge of triangle `other` away from its `corner` may run inside all three sides of
    `triangle`, as far as the volumes that it spans with them are certain."""
    j, k = (corner + 1) % 3, (corner + 2) % 3
    sx, sy, sz = corners[other, j, 0], corners[other, j, 1], corners[other, j, 2]
    ex, ey, ez = corners[other, k, 0] - sx, corners[other, k, 1] - sy, corners[other, k, 2] - sz
    left, right = False, False
    for i in range(3):
        n = (i + 1) % 3
        ax, ay, az = (
            corners[triangle, i, 0] - sx, corners[triangle, i, 1] - sy, corners[triangle, i, 2] - sz
        )  # fmt: skip
        bx, by, bz = (
            corners[triangle, n, 0] - sx, corners[triangle, n, 1] - sy, corners[triangle, n, 2] - sz
        )  # fmt: skip
        turn = ex * (ay * bz - az * by) + ey * (az * bx - ax * bz) + ez * (ax * by - ay * bx)
        size = (abs(ax) + abs(ay) + abs(az)) * (abs(bx) + abs(by) + abs(bz))
        slack = ROUNDED * size * (abs(ex) + abs(ey) + abs(ez))
        left |= turn > slack
        right |= turn < -slack
    return not (left and right)


@inline
def _cross(corners, faces, planes, slack, one, other):
    """Whether two triangles with at most one vertex in common may cross."""
    common = _common(faces, one, other)[0]
    if common > 1:
        return False
    straddles = (
        _straddles(corners, planes, slack, one, other),
        _straddles(corners, planes, slack, other, one),
    )
    if not (straddles[0] and straddles[1]) and (common == 0 or straddles[0] == straddles[1]):
        return False
    for turn in range(2):
        through, edges = (one, other) if turn == 0 else (other, one)
        corner = _common(faces, through, edges)[1]
        for k in range(3):
            # With a common vertex it is the edge away from that which passes through.
            asked = straddles[turn] and (common == 0 or k == corner)
            if asked and _passes(corners, edges, k, through):
                return True
    return False


@compiled
def candidates(boxes, order, waiting, left, corners, faces, planes, slack, found):
    """How many pairs of triangles below the first `left` pairs of boxes in `waiting` may cross; as
    many as there is room for are written to `found` (k, 2).

    They have at most one vertex in common, lie on both sides of each other's plane as far as that
    is necessary, and an edge of one may run inside the sides of the other.

    boxes (2 s, 6): low and high corners, box k made of 2 k and 2 k + 1, 1 the root, those from s
    on the triangles' in their `order`; planes (f, 4): normal and offset; slack (f,): heights that
    count as none; waiting: with room for three more pairs for each level
    """
    leaves = len(boxes) // 2
    count = 0
    while left > 0:
        left -= 1
        a, b = waiting[left, 0], waiting[left, 1]
        if not _meet(boxes, a, b):
            continue
        if a < leaves:
            for k in range(4):
                c, d = 2 * a + k // 2, 2 * b + k % 2
                if c <= d:
                    waiting[left, 0], waiting[left, 1] = c, d
                    left += 1
            continue
        if a == b:
            continue
        one, other = order[a - leaves], order[b - leaves]
        if _cross(corners, faces, planes, slack, one, other):
            if count < len(found):
                found[count, 0], found[count, 1] = min(one, other), max(one, other)
            count += 1
    return count
