"""Fewer or smoother triangles, for those who ask: both move the surface, and both say how far."""

from __future__ import annotations

from dataclasses import dataclass

import fast_simplification
import igl
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mpf_core.errors import SurfaceError
from mpf_core.surface.cut import pieces
from mpf_core.surface.manifold import same_corners, separated

# Of fast-simplification: lower ones tear less. Its default, 7, pinched four bubbles off a thin
# wall with 61 pinholes, 5 none, in the same time.
AGGRESSION = (5, 3)
SLACK = 1.02  # of the faces asked for: single collapses end a little above or below
# Taubin's filter: a shrinking and a growing step with no effect on frequencies below 0.1.
SHRINK, GROW = 0.5, -0.526
PROBES = 100_000  # points on each mesh between which the distance is measured

Array = NDArray[np.float64]
Faces = NDArray[np.int64]


@dataclass(frozen=True)
class Deviation:
    """Distances between two meshes, both ways: mean of the two means, and the largest found at
    `points` vertices and middles of triangles on each."""

    mean: float
    largest: float
    points: int


def decimated(vertices: Array, faces: Faces, target: int) -> tuple[Array, Faces]:
    """At most about `target` faces, by quadric edge collapse (Garland and Heckbert 1997).

    The result has as many pieces as the mesh given, no boundary if that had none, and no more
    edges of three triangles: where walls touch they are parted (`manifold`). Raises SurfaceError
    when so few faces cannot be had like this.
    """
    if len(faces) <= target:
        return vertices, faces
    middle = (vertices.min(0) + vertices.max(0)) / 2
    wanted = _defects(faces)
    for aggression in AGGRESSION:
        points, triangles = fast_simplification.simplify(
            vertices - middle, faces.astype(np.int32), target_count=target, agg=aggression
        )
        points, fewer = separated(points, np.asarray(triangles, dtype=np.int64))
        enough = 0 < len(fewer) <= SLACK * target + 4
        if enough and all(a <= b for a, b in zip(_defects(fewer), wanted, strict=True)):
            names, dense = np.unique(fewer, return_inverse=True)
            return np.asarray(points, np.float64)[names] + middle, dense.reshape(-1, 3)
    raise SurfaceError(
        f"the surface cannot be had with {target} faces and stay whole",
        where="max_faces",
        advice="Ask for more faces.",
    )


def taubin(vertices: Array, faces: Faces, rounds: int) -> Array:
    """Vertices after `rounds` of Taubin's filter (1995), which smooths without shrinking.

    The curve of a boundary is smoothed along itself only.
    """
    mean = neighbour_mean(faces, len(vertices))
    middle: Array = vertices.mean(0)
    moved: Array = vertices - middle
    for _ in range(rounds):
        for share in (SHRINK, GROW):
            moved = moved + share * (mean @ moved - moved)
    back: Array = moved + middle
    return back


def deviation(first: tuple[Array, Faces], second: tuple[Array, Faces]) -> Deviation:
    """How far two meshes (vertices, faces) are from each other, in their units."""
    middle = first[0].mean(0)
    one, other = (
        (np.ascontiguousarray(mesh[0] - middle), np.ascontiguousarray(mesh[1]))
        for mesh in (first, second)
    )
    there, back = _distances(one, other), _distances(other, one)
    return Deviation(
        mean=float((there.mean() + back.mean()) / 2),
        largest=float(max(there.max(), back.max())),
        points=max(len(there), len(back)),
    )


def _distances(source: tuple[Array, Faces], target: tuple[Array, Faces]) -> Array:
    probes = np.concatenate([source[0], source[0][source[1]].mean(1)])
    probes = probes[:: max(1, len(probes) // PROBES)]
    squared, _, _ = igl.point_mesh_squared_distance(probes, *target)
    distances: Array = np.sqrt(np.maximum(squared, 0))
    return distances


def _defects(faces: Faces) -> tuple[int, bool, int, int]:
    """What decimation must not add to: edges of more than two triangles, any edge of one,
    triangles that lie on another, and, negative, pieces."""
    _, count = _edges(faces)
    there = np.bincount(faces.ravel()) > 0
    connected = pieces(faces, len(there))[0] - int((~there).sum())  # a vertex alone is none
    alike = len(faces) - 1 - int(same_corners(faces).max(initial=-1))
    return int((count > 2).sum()), bool((count == 1).any()), alike, -connected


def _edges(faces: Faces) -> tuple[Faces, NDArray[np.int64]]:
    """(e, 2) edges, lower vertex first, and how many triangles each has."""
    size = int(faces.max(initial=0)) + 1
    start, stop = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    key, count = np.unique(
        np.minimum(start, stop) * size + np.maximum(start, stop), return_counts=True
    )
    return np.stack(np.divmod(key, size), axis=1), count


def neighbour_mean(faces: Faces, vertices: int) -> sparse.csr_array:
    """(v, v) mean over the neighbours of a vertex; of a boundary's, over those along it."""
    edges, count = _edges(faces)
    on_rim = np.zeros(vertices, dtype=bool)
    on_rim[edges[count == 1]] = True
    tail = np.concatenate([edges[:, 0], edges[:, 1], np.arange(vertices)])
    head = np.concatenate([edges[:, 1], edges[:, 0], np.arange(vertices)])
    along = np.concatenate([count == 1, count == 1, np.zeros(vertices, dtype=bool)])
    weight = np.where(on_rim[tail], along, 1.0)
    weight[2 * len(edges) :] = 1e-9  # what has no neighbour stays
    total = np.bincount(tail, weights=weight, minlength=vertices)
    entries = (weight / total[tail], (tail, head))
    return sparse.coo_array(entries, shape=(vertices, vertices)).tocsr()
