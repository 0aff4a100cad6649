"""Pairs of triangles of one mesh that pass through each other.

Candidates come from a binary tree of boxes over the triangles in Morton order, walked against
itself; each is then decided by segment–triangle tests. Counted are proper crossings: touching,
coplanar overlap and folding about a shared edge are not.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from mpf_core.field.pointwise import loops
from mpf_core.heeding import heed
from mpf_core.parallel import mapped
from mpf_core.progress import CancelCheck
from mpf_core.surface.mesh import Mesh

# A vertex nearer to a triangle's plane than this share of the triangle's size is on the plane.
ON_PLANE = 1e-9
# The compiled walk leaves out what is on one side of a plane for certain: sums are rounded
# otherwise there, and what is decided must not depend on a compiler.
CERTAIN = 0.5
PAIRS_AT_ONCE = 100_000
PARTS = 64  # of the walk, taken by whichever thread is free
COMPILED = "mpf_core.surface.meeting"  # by name: it loads the compiler

Pairs = NDArray[np.int64]
Corners = NDArray[np.float64]


def self_intersections(mesh: Mesh) -> Pairs:
    """(k, 2) pairs of faces, lower first, whose interiors cross."""
    if len(mesh.faces) < 2:
        return np.zeros((0, 2), np.int64)
    # Relative to the middle, so that nearly parallel planes far from the origin stay apart.
    vertices = mesh.vertices - mesh.vertices[mesh.faces].reshape(-1, 3).mean(axis=0)
    triangles = _Triangles.of(vertices[mesh.faces], mesh.faces)
    tree, walk = Boxes.of(triangles.corners), compiled_walk()
    slack = CERTAIN * triangles.tolerance

    def crossing(part: Pairs) -> Pairs:
        if walk is None:
            batches = tree.meeting(part)
        else:
            batches = iter([_candidates(walk, triangles, slack, tree, part)])
        found = [_crossing(triangles, pairs) for pairs in batches if len(pairs)]
        return np.concatenate([*found, np.zeros((0, 2), np.int64)])

    return np.concatenate(mapped(crossing, tree.parts()))


def compiled_walk(cancel: CancelCheck | None = None) -> ModuleType | None:
    """The compiled walk, None where there is no compiler; raises Cancelled as `loops`."""
    return loops(COMPILED, cancel)


def _candidates(
    walk: ModuleType, triangles: _Triangles, slack: NDArray[np.float64], tree: Boxes, part: Pairs
) -> Pairs:
    """The pairs below `part` that may cross."""
    most = 64 + len(triangles.faces) // PARTS
    while True:
        waiting = np.concatenate([part, np.empty((3 * tree.depth, 2), np.int64)])
        found = np.empty((most, 2), np.int64)
        count = walk.candidates(
            tree.boxes, tree.order, waiting, len(part), triangles.corners, triangles.faces,
            triangles.planes, slack, found,
        )  # fmt: skip
        if count <= most:
            return found[:count]
        most = count


@dataclass(frozen=True)
class Boxes:
    """A tree of boxes over triangles, sorted by `order` (f,).

    boxes: (2 s, 6) low and high corners: box k is made of 2 k and 2 k + 1, 1 is the root, and those
    from s, a power of two, on are the triangles' own, padded by empty ones
    """

    order: NDArray[np.int64]
    boxes: Corners

    @classmethod
    def of(cls, corners: Corners) -> Boxes:
        """Of triangles (f, 3, 3)."""
        a, b, c = (corners[:, k] for k in range(3))
        order = _morton_order(a + b + c)
        size = 1 << max(len(order) - 1, 0).bit_length()
        boxes = np.full((2 * size, 6), np.inf)
        boxes[:, 3:] = -np.inf
        own = boxes[size : size + len(order)]
        own[:, :3] = np.minimum(np.minimum(a, b), c)[order]
        own[:, 3:] = np.maximum(np.maximum(a, b), c)[order]
        while size > 1:
            left, right = boxes[size : 2 * size : 2], boxes[size + 1 : 2 * size : 2]
            size //= 2
            np.minimum(left[:, :3], right[:, :3], out=boxes[size : 2 * size, :3])
            np.maximum(left[:, 3:], right[:, 3:], out=boxes[size : 2 * size, 3:])
        return cls(order, boxes)

    @property
    def depth(self) -> int:
        """How many levels there are."""
        return len(self.boxes).bit_length() - 1

    def parts(self) -> list[Pairs]:
        """Where to begin, in so many parts that threads are evenly busy; not fewer for fewer."""
        pairs = np.ones((1, 2), np.int64)
        while 0 < len(pairs) < PARTS and not self._own(pairs):
            pairs = _children(self._meeting(pairs))
        return [part for part in np.array_split(pairs, PARTS) if len(part)]

    def meeting(self, part: Pairs) -> Iterator[Pairs]:
        """Batches of pairs (i < j) of triangles below `part` whose boxes meet."""
        waiting = [part]
        while waiting:
            heed()
            pairs = self._meeting(waiting.pop())
            if self._own(pairs):
                pairs = pairs[pairs[:, 0] != pairs[:, 1]] - len(self.boxes) // 2
                yield np.sort(self.order[pairs], axis=1)
                continue
            batches = range(0, len(pairs), PAIRS_AT_ONCE)
            waiting.extend(_children(pairs[k : k + PAIRS_AT_ONCE]) for k in batches)

    def _own(self, pairs: Pairs) -> bool:
        """Whether these, all of one level, are boxes of single triangles."""
        return len(pairs) == 0 or int(pairs[0, 0]) >= len(self.boxes) // 2

    def _meeting(self, pairs: Pairs) -> Pairs:
        for axis in range(3):
            low, high = self.boxes[:, axis], self.boxes[:, 3 + axis]
            a, b = pairs.T
            pairs = pairs[(low[a] <= high[b]) & (low[b] <= high[a])]
        return pairs


def _children(pairs: Pairs) -> Pairs:
    """Pairs of the halves of each pair of boxes, each unordered pair once."""
    a, b = 2 * pairs.T
    halves = np.stack([a, b, a, b + 1, a + 1, b, a + 1, b + 1], axis=1).reshape(-1, 2)
    return halves[halves[:, 0] <= halves[:, 1]]


def _morton_order(points: Corners) -> NDArray[np.int64]:
    """Indices that sort (n, 3) points along a Z-curve of 2¹⁰ cells a side."""
    low = points.min(axis=0)
    extent = float((points.max(axis=0) - low).max()) or 1.0
    cells = np.minimum((points - low) * (1024 / extent), 1023).astype(np.int64)
    code = np.zeros(len(points), np.int64)
    for axis in range(3):
        code |= _spread(cells[:, axis]) << axis
    return np.argsort(code, kind="stable")


def _spread(values: NDArray[np.int64]) -> NDArray[np.int64]:
    """(n,) numbers below 2¹⁰ with two zeros after each of their bits."""
    for shift, mask in ((16, 0x030000FF), (8, 0x0300F00F), (4, 0x030C30C3), (2, 0x09249249)):
        values = (values | (values << shift)) & mask
    return values


@dataclass(frozen=True)
class _Triangles:
    """f triangles: `corners` (f, 3, 3), `faces` (f, 3), `planes` (f, 4) their normals, not of unit
    length, and offsets, and the `tolerance` (f,) of heights over them."""

    corners: Corners
    faces: NDArray[np.int64]
    planes: Corners
    tolerance: NDArray[np.float64]

    @classmethod
    def of(cls, corners: Corners, faces: NDArray[np.int64]) -> _Triangles:
        a, b, c = (corners[:, k] for k in range(3))
        normal = np.cross(b - a, c - a)
        size = np.maximum(np.linalg.norm(b - a, axis=1), np.linalg.norm(c - a, axis=1))
        tolerance = ON_PLANE * np.linalg.norm(normal, axis=1) * size
        planes = np.column_stack([normal, np.einsum("fi,fi->f", normal, a)])
        return cls(corners, np.ascontiguousarray(faces, np.int64), planes, tolerance)

    def straddled(self, planes: NDArray[np.int64], others: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Whether triangles `others` have vertices on both sides of the planes of `planes`."""
        heights = (self.corners[others] @ self.planes[planes, :3, None])[:, :, 0]
        heights -= self.planes[planes, 3:]
        tolerance = self.tolerance[planes]
        return np.asarray((heights.max(1) > tolerance) & (heights.min(1) < -tolerance))


def _crossing(triangles: _Triangles, pairs: Pairs) -> Pairs:
    """Those of `pairs` that cross."""
    corners, faces = triangles.corners, triangles.faces
    # Nearly all pairs of a smooth surface end here, so this comes first.
    by_first = triangles.straddled(pairs[:, 0], pairs[:, 1])
    by_second = triangles.straddled(pairs[:, 1], pairs[:, 0])
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
