"""Pairs of triangles of one mesh that pass through each other.

Candidates come from a binary tree of boxes over the triangles in Morton order, walked against
itself level by level; each is then decided by segment–triangle tests. Counted are proper
crossings: touching, coplanar overlap and folding about a shared edge are not.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mpf_core.heeding import heed
from mpf_core.parallel import mapped
from mpf_core.surface.mesh import Mesh

# A vertex nearer to a triangle's plane than this share of the triangle's size is on the plane.
ON_PLANE = 1e-9
PAIRS_AT_ONCE = 100_000
PARTS = 64  # of the walk, taken by whichever thread is free

Pairs = NDArray[np.int64]
Part = tuple[int, Pairs]  # pairs of boxes at a depth of the tree
Corners = NDArray[np.float64]


def self_intersections(mesh: Mesh) -> Pairs:
    """(k, 2) pairs of faces, lower first, whose interiors cross."""
    if len(mesh.faces) < 2:
        return np.zeros((0, 2), np.int64)
    # Relative to the middle, so that nearly parallel planes far from the origin stay apart.
    corners = mesh.vertices[mesh.faces]
    corners = corners - corners.reshape(-1, 3).mean(axis=0)
    planes, boxes = _Planes.of(corners), Boxes.of(corners)

    def crossing(part: Part) -> Pairs:
        found = [_crossing(corners, planes, mesh.faces, pairs) for pairs in boxes.meeting(part)]
        return np.concatenate([*found, np.zeros((0, 2), np.int64)])

    return np.concatenate(mapped(crossing, boxes.parts()))


@dataclass(frozen=True)
class Boxes:
    """A tree of boxes over triangles (f, 3, 3), sorted by `order` (f,): its `levels`, as
    `_box_tree` has them."""

    order: NDArray[np.int64]
    levels: list[tuple[Corners, Corners]]

    @classmethod
    def of(cls, corners: Corners) -> Boxes:
        order = _morton_order(corners.mean(axis=1))
        return cls(order, _box_tree(corners[order].min(axis=1), corners[order].max(axis=1)))

    def parts(self) -> list[Part]:
        """Where to begin, in so many parts that threads are evenly busy; not fewer for fewer."""
        depth, pairs = 0, np.zeros((1, 2), np.int64)
        while len(pairs) < PARTS and depth + 1 < len(self.levels):
            depth, pairs = depth + 1, _children(self._meeting_at(depth, pairs))
        return [(depth, part) for part in np.array_split(pairs, PARTS) if len(part)]

    def meeting(self, part: Part) -> Iterator[Pairs]:
        """Batches of pairs (i < j) of triangles below `part` whose boxes meet."""
        waiting = [part]
        while waiting:
            heed()
            depth, pairs = waiting.pop()
            pairs = self._meeting_at(depth, pairs)
            if depth + 1 == len(self.levels):
                pairs = pairs[pairs[:, 0] != pairs[:, 1]]
                yield np.sort(self.order[pairs], axis=1)
                continue
            batches = range(0, len(pairs), PAIRS_AT_ONCE)
            waiting.extend((depth + 1, _children(pairs[k : k + PAIRS_AT_ONCE])) for k in batches)

    def _meeting_at(self, depth: int, pairs: Pairs) -> Pairs:
        low, high = self.levels[depth]
        for axis in range(3):
            a, b = pairs.T
            meet = (low[axis, a] <= high[axis, b]) & (low[axis, b] <= high[axis, a])
            pairs = pairs[meet]
        return pairs


def _children(pairs: Pairs) -> Pairs:
    """Pairs of the halves of each pair of boxes, each unordered pair once."""
    a, b = 2 * pairs.T
    halves = np.stack([a, b, a, b + 1, a + 1, b, a + 1, b + 1], axis=1).reshape(-1, 2)
    return halves[halves[:, 0] <= halves[:, 1]]


def _box_tree(low: Corners, high: Corners) -> list[tuple[Corners, Corners]]:
    """(3, boxes) corners of each level, the root first; box i is made of 2i and 2i + 1 of the next.

    The leaves are padded to a power of two by empty boxes.
    """
    size = 1 << max(len(low) - 1, 0).bit_length()
    padding = ((0, 0), (0, size - len(low)))
    low = np.pad(low.T, padding, constant_values=np.inf)
    high = np.pad(high.T, padding, constant_values=-np.inf)
    levels = [(low, high)]
    while low.shape[1] > 1:
        low = np.minimum(low[:, ::2], low[:, 1::2])
        high = np.maximum(high[:, ::2], high[:, 1::2])
        levels.append((low, high))
    return levels[::-1]


def _morton_order(points: Corners) -> NDArray[np.int64]:
    """Indices that sort (n, 3) points along a Z-curve of 2¹⁰ cells a side."""
    low = points.min(axis=0)
    extent = float((points.max(axis=0) - low).max()) or 1.0
    cells = np.minimum((points - low) / extent * 1024, 1023).astype(np.int64)
    code = np.zeros(len(points), np.int64)
    for bit in range(10):
        for axis in range(3):
            code |= ((cells[:, axis] >> bit) & 1) << (3 * bit + axis)
    return np.argsort(code, kind="stable")


@dataclass(frozen=True)
class _Planes:
    """Of each of f triangles: normal (f, 3), not of unit length, offset and tolerance (f,)."""

    normal: Corners
    offset: NDArray[np.float64]
    tolerance: NDArray[np.float64]

    @classmethod
    def of(cls, corners: Corners) -> _Planes:
        a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
        normal = np.cross(b - a, c - a)
        size = np.maximum(np.linalg.norm(b - a, axis=1), np.linalg.norm(c - a, axis=1))
        tolerance = ON_PLANE * np.linalg.norm(normal, axis=1) * size
        return cls(normal, (normal * a).sum(1), tolerance)

    def straddled(
        self, corners: Corners, planes: NDArray[np.int64], others: NDArray[np.int64]
    ) -> NDArray[np.bool_]:
        """Whether triangles `others` have vertices on both sides of the planes of `planes`."""
        heights = (corners[others] @ self.normal[planes][:, :, None])[:, :, 0]
        heights -= self.offset[planes][:, None]
        tolerance = self.tolerance[planes]
        return np.asarray((heights.max(1) > tolerance) & (heights.min(1) < -tolerance))


def _crossing(corners: Corners, planes: _Planes, faces: NDArray[np.int64], pairs: Pairs) -> Pairs:
    """Those of `pairs` that cross."""
    # Nearly all pairs of a smooth surface end here, so this comes first.
    by_first = planes.straddled(corners, pairs[:, 0], pairs[:, 1])
    by_second = planes.straddled(corners, pairs[:, 1], pairs[:, 0])
    either = by_first | by_second
    pairs, straddled = pairs[either], (by_first[either], by_second[either])
    shared = _shared_vertices(faces, pairs)
    apart = pairs[(shared == 0) & straddled[0] & straddled[1]]
    crossing = [apart[_edges_cross(corners[apart[:, 0]], corners[apart[:, 1]])]]
    # Two triangles with a common vertex cross where the edge away from it passes through.
    for one, other in ((0, 1), (1, 0)):
        cut = pairs[(shared == 1) & straddled[one]]
        away = _away_from_shared(faces[cut[:, other]], faces[cut[:, one]])
        start, stop = (corners[cut[:, other], k] for k in away.T)
        crossing.append(cut[_segment_cuts(start, stop, corners[cut[:, one]])])
    return np.unique(np.concatenate(crossing), axis=0)


def _shared_vertices(faces: NDArray[np.int64], pairs: Pairs) -> NDArray[np.int64]:
    """(k,) number of vertices that the two triangles of each pair have in common."""
    ours, theirs = faces[pairs[:, 0]], faces[pairs[:, 1]]
    shared = np.zeros(len(pairs), np.int64)
    for i in range(3):
        for j in range(3):
            shared += ours[:, i] == theirs[:, j]
    return shared


def _away_from_shared(ours: NDArray[np.int64], theirs: NDArray[np.int64]) -> NDArray[np.int64]:
    """(k, 2) corners of `ours` that follow the one that is also a corner of `theirs`."""
    lead = (ours[:, :, None] == theirs[:, None, :]).any(axis=2).argmax(axis=1)
    return np.stack([(lead + 1) % 3, (lead + 2) % 3], axis=1)


def _heights(triangles: Corners, points: Corners) -> NDArray[np.float64]:
    """(k, m) heights of points (k, m, 3) over the planes of triangles (k, 3, 3); 0 when on it."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    normal = np.cross(b - a, c - a)
    height = ((points - a[:, None]) @ normal[:, :, None])[:, :, 0]
    size = np.maximum(np.linalg.norm(b - a, axis=1), np.linalg.norm(c - a, axis=1))
    tolerance = ON_PLANE * np.linalg.norm(normal, axis=1) * size
    return np.where(np.abs(height) > tolerance[:, None], height, 0.0)


def _edges_cross(first: Corners, second: Corners) -> NDArray[np.bool_]:
    """Whether an edge of one triangle of a pair passes through the other."""
    crossing = np.zeros(len(first), bool)
    for one, other in ((first, second), (second, first)):
        for k in range(3):
            crossing |= _segment_cuts(one[:, k], one[:, (k + 1) % 3], other)
    return crossing


def _segment_cuts(start: Corners, stop: Corners, triangles: Corners) -> NDArray[np.bool_]:
    """Whether segments (k, 3)–(k, 3) pass properly through triangles (k, 3, 3)."""
    height = _heights(triangles, np.stack([start, stop], axis=1))
    spokes = triangles - start[:, None]
    along = (stop - start)[:, None]
    # Volumes spanned by the segment and each side: equal signs when it runs inside all three.
    turns = (np.cross(spokes, np.roll(spokes, -1, axis=1)) * along).sum(axis=2)
    inside = (turns > 0).all(axis=1) | (turns < 0).all(axis=1)
    return np.asarray((height[:, 0] * height[:, 1] < 0) & inside)
