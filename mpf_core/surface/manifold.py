"""Closed meshes that touch themselves along an edge, made manifold: one wall apart from the other.

Edge collapses pull a tunnel through a thin wall together into an edge of four triangles, or into
two triangles on one another. Which triangles share a vertex changes, the surface itself does not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from mpf_core.surface.mesh import Mesh
from mpf_core.surface.normals import face_normals

ROUNDS = 8  # of bisection: in each a triangle gives way to one edge only

Array = NDArray[np.float64]
Faces = NDArray[np.int64]


def separated(vertices: Array, faces: Faces) -> tuple[Array, Faces]:
    """The closed, oriented mesh with every edge of four triangles parted into two of two, and every
    vertex in which two fans of triangles touch into two.

    Of the two ways to part them the flatter one is taken. Pairs of triangles on one another, facing
    apart, are left out. What cannot be parted so (a boundary, six triangles) stays.
    """
    faces = _without_flaps(faces)
    edges = _Edges.of(vertices, faces)
    apart = _parted(vertices, faces, edges)
    if not len(edges.four) and len(apart[0]) == len(np.unique(faces)):
        return vertices, faces
    vertices, faces = apart
    for _ in range(ROUNDS):
        edges = _Edges.of(vertices, faces)
        if not len(edges.four):
            break
        vertices, faces = _bisected(vertices, faces, edges.four)
    return vertices, faces


@dataclass(frozen=True)
class _Edges:
    """Half-edge 3 f + k leads from corner k of triangle f to the next one.

    two: (p, 2) half-edges of the same edge, one each way; four: (m, 2, 2) likewise, of edges with
    two each way, joined by twos.
    """

    two: Faces
    four: Faces

    @classmethod
    def of(cls, vertices: Array, faces: Faces) -> _Edges:
        tail, head = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
        size = int(faces.max(initial=0)) + 1
        key = np.minimum(tail, head) * size + np.maximum(tail, head)
        order = np.lexsort((tail > head, key))  # of each edge the upward half-edges come first
        _, start, count = np.unique(key[order], return_index=True, return_counts=True)
        upward = np.add.reduceat((tail < head)[order].astype(np.int64), start)
        plain = start[(count == 2) & (upward == 1)]
        four = order[start[(count == 4) & (upward == 2)][:, None] + np.arange(4)]
        normals = face_normals(Mesh(vertices, faces))[four // 3]
        alike = np.einsum("mui,mdi->mud", normals[:, :2], normals[:, 2:])
        straight = alike[:, 0, 0] + alike[:, 1, 1] >= alike[:, 0, 1] + alike[:, 1, 0]
        down = np.where(straight[:, None], four[:, 2:], four[:, :1:-1])
        two = np.stack([order[plain], order[plain + 1]], axis=1)
        return cls(two, np.stack([four[:, :2], down], axis=2))


def _without_flaps(faces: Faces) -> Faces:
    """Without pairs of triangles of the same three vertices: where the mesh is oriented, they face
    apart and enclose nothing."""
    group = same_corners(faces)
    kept: Faces = faces[np.bincount(group)[group] % 2 == 1]
    return kept


def same_corners(faces: Faces) -> NDArray[np.int64]:
    """(f,) the same number, from 0 on, for triangles that have all three corners in common."""
    # Integers sort several times as fast as the rows that np.unique would compare.
    low, middle, high = np.sort(faces, axis=1).T
    pair = low * (int(faces.max(initial=0)) + 1) + middle
    order = np.lexsort((high, pair))
    fresh = np.ones(len(faces), dtype=bool)
    fresh[1:] = (np.diff(pair[order]) != 0) | (np.diff(high[order]) != 0)
    group = np.empty(len(faces), dtype=np.int64)
    group[order] = np.cumsum(fresh) - 1
    return group


def _parted(vertices: Array, faces: Faces, edges: _Edges) -> tuple[Array, Faces]:
    """Corners share a vertex only if joined triangles lead from one to the other."""
    first, second = np.concatenate([edges.two, edges.four.reshape(-1, 2)]).T
    following = np.arange(3 * len(faces)).reshape(-1, 3)[:, [1, 2, 0]].ravel()
    one = np.concatenate([first, following[first]])
    other = np.concatenate([following[second], second])
    graph = sparse.coo_array((np.ones(len(one)), (one, other)), shape=(3 * len(faces),) * 2)
    count, corner = connected_components(graph, directed=False)
    where = np.empty(count, dtype=np.int64)
    where[corner] = faces.ravel()
    return vertices[where], corner.reshape(-1, 3).astype(np.int64)


def _bisected(vertices: Array, faces: Faces, four: Faces) -> tuple[Array, Faces]:
    """Where both pairs of an edge still have both its ends, one gets a vertex in the middle."""
    pairs = four[:, 1]
    _, firsts = np.unique(np.minimum(*(pairs // 3).T), return_index=True)
    pairs = pairs[firsts]
    seen, where = np.unique(pairs // 3, return_inverse=True)
    once = np.bincount(where.ravel(), minlength=len(seen)) == 1
    pairs = pairs[once[where.reshape(-1, 2)].all(1)]
    middle = len(vertices) + np.arange(len(pairs))
    corner, following = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    ends = vertices[corner[pairs[:, 0]]], vertices[following[pairs[:, 0]]]
    added = []
    changed = faces.copy().ravel()
    after = np.arange(3 * len(faces)).reshape(-1, 3)[:, [1, 2, 0]].ravel()
    for half in pairs.T:
        # (a, b, c) becomes (a, m, c) and (m, b, c).
        added.append(np.stack([middle, corner[after[half]], corner[after[after[half]]]], axis=1))
        changed[after[half]] = middle
    return (
        np.concatenate([vertices, (ends[0] + ends[1]) / 2]),
        np.concatenate([changed.reshape(-1, 3), *added]),
    )
