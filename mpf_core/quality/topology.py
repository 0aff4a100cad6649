"""What a mesh is as a complex of triangles: pieces, holes, edges and vertices out of order."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from mpf_core.surface.mesh import Mesh

SLIVER_DEGREES = 2.0


@dataclass(frozen=True)
class Topology:
    """Counts over the triangles that have three different corners and the vertices they use.

    components: pieces connected through shared vertices
    boundary_edges, boundary_loops: edges of one triangle, and the curves they form
    nonmanifold_edges: edges of three or more triangles
    nonmanifold_vertices: vertices whose triangles do not form one fan
    inconsistent_edges: edges whose two triangles run along them in the same direction
    euler_characteristic: vertices - edges + faces
    watertight: every edge has exactly two triangles
    slivers: triangles with an angle below 2 degrees; degenerate_faces have no area at all
    """

    vertices: int
    faces: int
    components: int
    boundary_edges: int
    boundary_loops: int
    nonmanifold_edges: int
    nonmanifold_vertices: int
    inconsistent_edges: int
    euler_characteristic: int
    watertight: bool
    slivers: int
    degenerate_faces: int


def topology(mesh: Mesh) -> Topology:
    """Counts of `mesh` as it is indexed: equal positions under different indices are not joined."""
    proper = _distinct_corners(mesh.faces)
    faces = mesh.faces[proper]
    used, dense = np.unique(faces, return_inverse=True)
    faces = dense.reshape(-1, 3).astype(np.int64)
    edges = _Edges(faces, len(used))
    smallest = smallest_angles(Mesh(mesh.vertices, mesh.faces[proper]))
    flat = np.isnan(smallest)
    boundary = edges.ends[edges.counts == 1]
    return Topology(
        vertices=len(used),
        faces=len(mesh.faces),
        components=_pieces(edges.ends, len(used)),
        boundary_edges=len(boundary),
        boundary_loops=_loops(boundary, len(used)),
        nonmanifold_edges=int((edges.counts > 2).sum()),
        nonmanifold_vertices=_nonmanifold_vertices(faces, edges, len(used)),
        inconsistent_edges=int(((edges.counts == 2) & (edges.turns != 0)).sum()),
        euler_characteristic=len(used) - len(edges.ends) + len(faces),
        watertight=len(faces) > 0 and bool((edges.counts == 2).all()),
        slivers=int((smallest[~flat] < SLIVER_DEGREES).sum()),
        degenerate_faces=int((~proper).sum() + flat.sum()),
    )


def smallest_angles(mesh: Mesh) -> NDArray[np.float64]:
    """(f,) smallest angle of each triangle in degrees; NaN where it has no area."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    lengths = np.stack([np.linalg.norm(side, axis=1) for side in (c - b, a - c, b - a)], axis=1)
    ordered = np.sort(lengths, axis=1)
    double_area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    # The smallest angle lies between the two longest sides: area = ½ l₁ l₂ sin.
    product = ordered[:, 1] * ordered[:, 2]
    sine = np.divide(double_area, product, out=np.zeros(len(product)), where=product > 0)
    angles = np.degrees(np.arcsin(np.minimum(sine, 1)))
    return np.where(sine > 1e-12, angles, np.nan)


class _Edges:
    """Undirected edges of `faces`.

    half: (3f,) index of the undirected edge of half-edge 3·face + k, from corner k to k + 1
    ends: (e, 2) its vertices, lower first; counts: (e,) its triangles;
    turns: (e,) half-edges that run upwards less those that run downwards
    """

    def __init__(self, faces: NDArray[np.int64], vertices: int):
        start = faces.reshape(-1)
        stop = np.roll(faces, -1, axis=1).reshape(-1)
        key = np.minimum(start, stop) * max(vertices, 1) + np.maximum(start, stop)
        unique, self.half, self.counts = np.unique(key, return_inverse=True, return_counts=True)
        self.ends = np.stack(np.divmod(unique, max(vertices, 1)), axis=1)
        self.upward = start < stop
        direction = np.where(self.upward, 1.0, -1.0)
        self.turns = np.bincount(self.half, weights=direction, minlength=len(unique))


def _distinct_corners(faces: NDArray[np.int64]) -> NDArray[np.bool_]:
    a, b, c = faces.T
    return np.asarray((a != b) & (b != c) & (c != a))


def _pieces(links: NDArray[np.int64], nodes: int) -> int:
    return int(_labels(links, nodes).max(initial=-1)) + 1


def _labels(links: NDArray[np.int64], nodes: int) -> NDArray[np.int32]:
    """(nodes,) number of the connected piece each node is in."""
    if nodes == 0:
        return np.zeros(0, np.int32)
    ones = np.ones(len(links), dtype=np.int8)
    graph = coo_array((ones, (links[:, 0], links[:, 1])), shape=(nodes, nodes))
    labels: NDArray[np.int32] = connected_components(graph, directed=False)[1]
    return labels


def _loops(boundary: NDArray[np.int64], vertices: int) -> int:
    """Connected curves of boundary edges (two holes that touch in a vertex count as one)."""
    labels = _labels(boundary, vertices)
    return len(np.unique(labels[boundary[:, 0]])) if len(boundary) else 0


def _nonmanifold_vertices(faces: NDArray[np.int64], edges: _Edges, vertices: int) -> int:
    """Vertices on an edge of three triangles, or whose triangles fall apart into several fans.

    Corners of one vertex are linked across each shared edge; each fan is then one piece.
    """
    half = np.arange(faces.size)
    following = half - half % 3 + (half % 3 + 1) % 3
    low = np.where(edges.upward, half, following)
    high = np.where(edges.upward, following, half)
    order = np.argsort(edges.half, kind="stable")
    same = edges.half[order[:-1]] == edges.half[order[1:]]
    before, after = order[:-1][same], order[1:][same]
    links = np.concatenate([np.stack([end[before], end[after]], axis=1) for end in (low, high)])
    fan = _labels(links, faces.size)
    # A fan belongs to one vertex, so its first corner names it.
    _, first_corner = np.unique(fan, return_index=True)
    wrong = np.bincount(faces.reshape(-1)[first_corner], minlength=vertices) > 1
    wrong[edges.ends[edges.counts > 2]] = True
    return int(wrong.sum())
