"""How thick the walls of a mesh are, and how much of it is a double cover.

From points on the surface a ray goes back into the mesh, against the outward normal of its
triangle; the wall that it meets first from behind is the other side.
"""

from __future__ import annotations

from dataclasses import dataclass

import igl
import numpy as np
from numpy.typing import NDArray

from mpf_core.quality.sampling import sample_surface
from mpf_core.surface.mesh import Mesh
from mpf_core.surface.normals import face_normals

# In the frame where the reference's longest side is 2. The shells that fits wrap around sheets are
# up to 0.02 thick; walls of solids that are thicker than this limit are no covers.
LIMIT = 0.03
SAMPLES = 20_000
OPPOSITE = -0.5  # cosine between the two walls' normals: those of a cover face away from each other
_OFF = 1e-7  # of the start from its own triangle


@dataclass(frozen=True)
class DoubleCover:
    """share: of the area, with another wall less than LIMIT behind it; thickness: median distance
    to that wall along the normal, None where there is none."""

    share: float
    thickness: float | None


def double_cover(
    mesh: Mesh, *, limit: float = LIMIT, samples: int = SAMPLES, seed: int = 0
) -> DoubleCover:
    """The double cover of `mesh`, from area-uniform samples; lengths in the mesh's units."""
    drawn = sample_surface(mesh, samples, np.random.default_rng(seed), stratified=True)
    normals = face_normals(mesh)
    outward = normals[drawn.faces]
    size = float(np.ptp(mesh.vertices, axis=0).max())
    distance, met = _behind(mesh, drawn.points - _OFF * size * outward, -outward)
    facing = np.einsum("nd,nd->n", outward, normals[met])
    covered = (met >= 0) & (distance < limit) & (facing < OPPOSITE)
    thickness = float(np.median(distance[covered])) if covered.any() else None
    return DoubleCover(float(covered.mean()), thickness)


def _behind(
    mesh: Mesh, start: NDArray[np.float64], direction: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Distance to the first triangle that each ray meets, and its index, −1 where there is none."""
    tree = igl.AABB()
    vertices, faces = np.ascontiguousarray(mesh.vertices), np.ascontiguousarray(mesh.faces)
    tree.init(vertices, faces)
    face, distance, _ = tree.intersect_ray_first(
        vertices, faces, np.ascontiguousarray(start), np.ascontiguousarray(direction)
    )
    return np.asarray(distance, np.float64), np.asarray(face, np.int64)
