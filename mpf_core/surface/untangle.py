"""Triangles that marching cubes or coarsening left crossing, relaxed until they do not.

Six or more cut edges of one cell make a loop that bends in space, and the triangles that fill it
may fold through each other; merging triangles can do the same. Such a tangle is a few triangles
wide and has an edge over which its surface turns back. Its corners move to the mean of their
neighbours: by less than a cell, and the triangles stay as they are joined.
"""

from __future__ import annotations

import igl
import numpy as np
from numpy.typing import NDArray

from mpf_core.surface.intersections import self_intersections
from mpf_core.surface.mesh import Mesh
from mpf_core.surface.normals import face_normals
from mpf_core.surface.takeback import around, neighbours_of

ROUNDS = 5  # two tangles of some thirty took one round, the others two

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


def untangled(vertices: Array, faces: Indices) -> tuple[Array, int]:
    """The vertices (v, 3) where fewest triangles cross, and how many fewer than before.

    Only triangles near a sharp edge are looked at.
    """
    if not len(faces):
        return vertices, 0
    near = around(Mesh(vertices, faces), _turning_back(vertices, faces))
    found = self_intersections(Mesh(vertices, faces[near]))
    if not len(found):
        return vertices, 0
    before = left = len(np.unique(found))
    best, fewest, mean = vertices, len(found), neighbours_of(faces, len(vertices))
    for _ in range(ROUNDS):
        corners = np.unique(faces[near][found.ravel()])
        vertices = vertices.copy()
        vertices[corners] = mean[corners] @ vertices
        found = self_intersections(Mesh(vertices, faces[near]))
        if len(found) < fewest:
            fewest, best, left = len(found), vertices, len(np.unique(found))
        if not fewest:
            break
    return best, before - left


def _turning_back(vertices: Array, faces: Indices) -> Indices:
    """Faces whose normal is more than a right angle from that of one beside."""
    normals = face_normals(Mesh(vertices, faces))
    beside, _ = igl.triangle_triangle_adjacency(faces)  # (f, 3), −1 at a boundary
    cosine = np.einsum("fi,fki->fk", normals, normals[beside])
    return np.flatnonzero(((cosine < 0) & (beside >= 0)).any(1))
