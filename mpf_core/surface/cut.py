"""Cutting meshes open along the zero of a scalar, and closing holes: on indices and positions.

Orientation is kept throughout: what is cut or filled turns as its neighbours do.
"""

from __future__ import annotations

import heapq

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

Array = NDArray[np.float64]
Faces = NDArray[np.int64]

CLOSEST = 0.1  # of an edge: a cut nearer to its end than this would leave slivers


def clip(vertices: Array, faces: Faces, value: Array) -> tuple[Array, Faces, NDArray[np.int64]]:
    """The part of a mesh where the linear interpolation of `value` (v,) is not negative.

    Returns vertices, faces and, for each vertex, the one of the given mesh that it is or lies
    beside.
    """
    inside = value >= 0
    count = inside[faces].sum(1)
    one, two = faces[count == 1], faces[count == 2]
    one = _rolled(one, inside[one].argmax(1))  # the first corner is inside
    two = _rolled(two, (~inside[two]).argmax(1))  # the first corner is outside
    cuts = np.concatenate([one[:, [0, 1]], one[:, [0, 2]], two[:, [1, 0]], two[:, [2, 0]]])
    edges, which = np.unique(cuts, axis=0, return_inverse=True)  # (inside, outside)
    which = which.reshape(-1) + len(vertices)
    share = value[edges[:, 0]] / (value[edges[:, 0]] - value[edges[:, 1]])
    share = np.clip(share, CLOSEST, 1 - CLOSEST)[:, None]
    fresh = vertices[edges[:, 0]] * (1 - share) + vertices[edges[:, 1]] * share
    a, b, c, d = np.split(which, np.cumsum([len(one), len(one), len(two)]))
    kept = [
        faces[count == 3],
        np.stack([one[:, 0], a, b], 1),
        np.stack([two[:, 1], two[:, 2], d], 1),
        np.stack([two[:, 1], d, c], 1),
    ]
    origin = np.concatenate([np.arange(len(vertices)), edges[:, 0]])
    return used(np.concatenate([vertices, fresh]), np.concatenate(kept), origin)


def used(
    vertices: Array, faces: Faces, origin: NDArray[np.int64]
) -> tuple[Array, Faces, NDArray[np.int64]]:
    """Without the vertices that no face uses."""
    names, dense = np.unique(faces, return_inverse=True)
    return vertices[names], dense.reshape(-1, 3).astype(np.int64), origin[names]


def smoothed(faces: Faces, values: Array, rounds: int) -> Array:
    """`values` (v,) or (v, k) after `rounds` of averaging with the neighbours along edges."""
    n = len(values)
    tail = np.concatenate([faces.ravel(), np.roll(faces, -1, axis=1).ravel()])
    head = np.concatenate([np.roll(faces, -1, axis=1).ravel(), faces.ravel()])
    link = sparse.coo_array((np.ones(len(tail)), (tail, head)), shape=(n, n)).tocsr()
    link.data[:] = 1.0
    degree = np.maximum(link.sum(1), 1.0)
    out = np.asarray(values, dtype=np.float64)
    for _ in range(rounds):
        mean = (link @ out) / (degree if out.ndim == 1 else degree[:, None])
        out = (out + mean) / 2
    return out


def pieces(faces: Faces, vertices: int) -> tuple[int, NDArray[np.int32]]:
    """How many connected pieces there are, and which one each vertex is in."""
    tail, head = faces[:, [0, 1]].ravel(), faces[:, [1, 2]].ravel()
    graph = sparse.coo_array((np.ones(len(tail)), (tail, head)), shape=(vertices, vertices))
    count, labels = connected_components(graph, directed=False)
    return int(count), labels


def boundary_loops(faces: Faces) -> list[NDArray[np.int64]]:
    """Closed curves of edges that have one triangle, each as its vertices in the order in which
    the missing triangles would run; where two curves touch in a vertex they are parted there."""
    start, stop = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    size = int(faces.max(initial=0)) + 1
    there, back = start * size + stop, stop * size + start
    single = ~np.isin(there, back)
    following: dict[int, list[int]] = {}
    for a, b in zip(stop[single].tolist(), start[single].tolist(), strict=True):
        following.setdefault(a, []).append(b)
    loops = []
    for first in list(following):
        while following.get(first):
            path, place = [first], {first: 0}
            while following.get(path[-1]):
                step = following[path[-1]].pop()
                if step in place:  # a curve is closed; what led to it goes on
                    loops.append(np.array(path[place[step] :], dtype=np.int64))
                    for gone in path[place[step] + 1 :]:
                        del place[gone]
                    del path[place[step] + 1 :]
                    continue
                place[step] = len(path)
                path.append(step)
    return [loop for loop in loops if len(loop) >= 3]


def filled(vertices: Array, faces: Faces, loops: list[NDArray[np.int64]]) -> tuple[Array, Faces]:
    """The mesh with `loops` of its boundary closed.

    Where a new edge is there already, which would make it one of three triangles, the loop is
    closed by a fan about a new vertex in its middle.
    """
    size = len(vertices)
    start, stop = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    known = np.unique(np.minimum(start, stop) * size + np.maximum(start, stop))
    middles: list[Array] = []
    patches: list[Faces] = []
    for loop in loops:
        patch = filling(vertices, loop)
        a, b = np.sort(patch[:, [0, 2]], axis=1).T  # all but the last are edges across the hole
        if np.isin(a[:-1] * size + b[:-1], known).any():
            middle = size + len(middles)
            middles.append(vertices[loop].mean(0))
            patch = np.stack([loop, np.roll(loop, -1), np.full(len(loop), middle)], 1)
        patches.append(patch)
    return (
        np.concatenate([vertices, np.reshape(middles, (-1, 3))]),
        np.concatenate([faces, *patches]),
    )


def filling(vertices: Array, loop: NDArray[np.int64]) -> Faces:
    """(k - 2, 3) triangles that close a loop of k vertices, always by the shortest next edge.

    Thin slits are zipped up from their ends, round holes shrink evenly; no vertex is added.
    """
    n = len(loop)
    points = vertices[loop]
    after = [*range(1, n), 0]
    before = [n - 1, *range(n - 1)]

    def gap(k: int) -> float:
        return float(np.linalg.norm(points[before[k]] - points[after[k]]))

    waiting = [(gap(k), k, before[k], after[k]) for k in range(n)]
    heapq.heapify(waiting)
    closed, left, made = [False] * n, n, []
    while left > 2 and waiting:
        _, k, low, high = heapq.heappop(waiting)
        if closed[k] or before[k] != low or after[k] != high:
            continue
        made.append((low, k, high))
        closed[k] = True
        left -= 1
        after[low], before[high] = high, low
        for other in (low, high):
            heapq.heappush(waiting, (gap(other), other, before[other], after[other]))
    return loop[np.array(made, dtype=np.int64).reshape(-1, 3)]


def _rolled(faces: Faces, first: NDArray[np.int64]) -> Faces:
    """Each face with its corner `first` in front."""
    order = (first[:, None] + np.arange(3)) % 3
    return np.take_along_axis(faces, order, axis=1)
