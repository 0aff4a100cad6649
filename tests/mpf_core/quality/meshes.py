"""Small meshes for tests of metrics and pictures."""

from __future__ import annotations

import numpy as np
import trimesh
from numpy.typing import NDArray

from mpf_core.surface.mesh import Mesh


def as_mesh(made: trimesh.Trimesh) -> Mesh:
    return Mesh(np.array(made.vertices, np.float64), np.array(made.faces, np.int64))


def icosphere(subdivisions: int, radius: float = 1.0) -> Mesh:
    return as_mesh(trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius))


def box(*extents: float) -> Mesh:
    return as_mesh(trimesh.creation.box(extents or (2, 2, 2)))


def grid_sheet(n: int, *, half: float = 1.0, z: float = 0.0) -> Mesh:
    """A flat square of n × n vertices, its normal along +z."""
    x, y = np.meshgrid(*[np.linspace(-half, half, n)] * 2, indexing="ij")
    i = np.arange(n * n).reshape(n, n)
    corners = i[:-1, :-1].ravel(), i[1:, :-1].ravel(), i[1:, 1:].ravel(), i[:-1, 1:].ravel()
    a, b, c, d = corners
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    vertices = np.stack([x.ravel(), y.ravel(), np.full(n * n, z)], axis=1)
    return Mesh(vertices, faces.astype(np.int64))


def joined(*meshes: Mesh) -> Mesh:
    offsets = np.cumsum([0, *(len(m.vertices) for m in meshes[:-1])])
    return Mesh(
        np.concatenate([m.vertices for m in meshes]),
        np.concatenate([m.faces + k for m, k in zip(meshes, offsets, strict=True)]),
    )


def moved(mesh: Mesh, scale: float, shift: NDArray[np.float64]) -> Mesh:
    return Mesh(mesh.vertices * scale + shift, mesh.faces)
