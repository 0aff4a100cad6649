"""Directions and areas of triangles, and normals at their vertices."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mpf_core.surface.mesh import Mesh


def face_crosses(mesh: Mesh) -> NDArray[np.float64]:
    """(f, 3) normal of each triangle, as long as twice its area."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def face_areas(mesh: Mesh) -> NDArray[np.float64]:
    """(f,) area of each triangle, in squared units of the mesh."""
    return np.asarray(np.linalg.norm(face_crosses(mesh), axis=1) / 2)


def enclosed_volume(mesh: Mesh) -> float:
    """Volume within a closed mesh, in cubed units; negative when its inside is turned out."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] - mesh.vertices.mean(0) for k in range(3))
    return float(np.einsum("fi,fi->", a, np.cross(b, c)) / 6)


def face_normals(mesh: Mesh) -> NDArray[np.float64]:
    """(f, 3) unit normals; zero for triangles without area."""
    return _unit(face_crosses(mesh))


def vertex_normals(mesh: Mesh) -> NDArray[np.float64]:
    """(v, 3) unit normals: of the triangles at a vertex, each weighted by its angle there.

    Weighting by angle makes the result independent of how flat regions are cut into triangles.
    Where the triangles cancel or there are none, the normal is +z: it has to be of length 1.
    """
    directions = face_normals(mesh)
    normals = np.zeros_like(mesh.vertices)
    angles = corner_angles(mesh)
    for axis in range(3):
        weights = (angles * directions[:, axis : axis + 1]).reshape(-1)
        normals[:, axis] = np.bincount(
            mesh.faces.reshape(-1), weights=weights, minlength=len(mesh.vertices)
        )
    return unit_normals(normals)


def unit_normals(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """(v, 3) at length 1; +z where there is no direction (zero or not a number)."""
    return _unit(vectors, otherwise=np.array([0.0, 0.0, 1.0]))


def corner_angles(mesh: Mesh) -> NDArray[np.float64]:
    """(f, 3) angle of each triangle at each of its corners, in radians; 0 where a side has no
    length."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    u, v, w = b - a, c - b, a - c
    # Better than arccos of the cosine where the angle is small; twice the area serves all three.
    area = np.linalg.norm(np.cross(u, v), axis=1)
    # From 0, not the negative: of a side without length that would be -0, and the angle π.
    along = [0.0 - np.einsum("fi,fi->f", out, back) for out, back in ((u, w), (v, u), (w, v))]
    return np.asarray(np.arctan2(area[:, None], np.stack(along, axis=1)))


def _unit(
    vectors: NDArray[np.float64], otherwise: NDArray[np.float64] | None = None
) -> NDArray[np.float64]:
    """`vectors` at length 1; those too short to have a direction become `otherwise`, or zero."""
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    short = ~(lengths > 1e-300)  # also where the length is not a number
    replaced = np.zeros(3) if otherwise is None else otherwise
    return np.asarray(np.where(short, replaced, vectors / np.where(short, 1.0, lengths)))
