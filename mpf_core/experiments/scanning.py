"""A range scanner that looks at a shape: rays from several places, noise along each ray.

What no ray reaches has no points, so sheets are mostly seen from one side and hidden parts are
missing, as in real scans.
"""

from __future__ import annotations

from dataclasses import dataclass

import igl
import numpy as np
from numpy.typing import NDArray

from mpf_core.cloud.pointcloud import PointCloud
from mpf_core.surface.mesh import Mesh
from mpf_core.surface.normals import face_normals

Floats = NDArray[np.float64]
# Surfaces seen at a flatter angle than this send too little back.
GRAZING_COSINE = 0.12


@dataclass(frozen=True)
class Viewpoint:
    """A scanner at `eye` looking at `target`, in the shape's units; its cone in degrees."""

    eye: tuple[float, float, float]
    target: tuple[float, float, float] = (0.0, 0.0, 0.0)
    cone: float = 34.0


def ring(
    count: int, elevation: float, distance: float = 4.0, *, start: float = 0.0
) -> tuple[Viewpoint, ...]:
    """`count` viewpoints around the origin, evenly spaced; angles in degrees."""
    rise = np.radians(elevation)
    turns = np.radians(start) + 2 * np.pi * np.arange(count) / count
    places = [(np.cos(t) * np.cos(rise), np.sin(t) * np.cos(rise), np.sin(rise)) for t in turns]
    return tuple(
        Viewpoint((float(distance * x), float(distance * y), float(distance * z)))
        for x, y, z in places
    )


def scan(
    mesh: Mesh,
    viewpoints: tuple[Viewpoint, ...],
    count: int,
    *,
    noise: float,
    seed: int = 0,
) -> PointCloud:
    """`count` points (or fewer, if all rays together hit less) measured on `mesh`.

    noise: standard deviation along the ray where it meets the surface head-on, in the mesh's
    units; it grows with the slant. Colours are those of the mesh, if it has any.
    """
    rng = np.random.default_rng(seed)
    tree = igl.AABB()
    tree.init(mesh.vertices, mesh.faces)
    normals = face_normals(mesh)
    # Twice what is wanted, as most shapes leave half of a cone empty.
    rays = max(64, 4 * count // len(viewpoints))
    while True:
        views = [_look(mesh, tree, normals, v, rays, noise, rng) for v in viewpoints]
        found = sum(len(points) for points, _ in views)
        if found >= count or rays > 40 * count:
            break
        rays *= 2
    points = np.concatenate([points for points, _ in views])
    colors = np.concatenate([colors for _, colors in views])
    chosen = rng.permutation(found)[:count]
    return PointCloud(points[chosen], colors=colors[chosen] if mesh.colors is not None else None)


def _look(
    mesh: Mesh,
    tree: igl.AABB,
    normals: Floats,
    viewpoint: Viewpoint,
    rays: int,
    noise: float,
    rng: np.random.Generator,
) -> tuple[Floats, NDArray[np.uint8]]:
    """Points (n, 3) and colours (n, 3) that one viewpoint measures."""
    directions = _directions(viewpoint, rays, rng)
    eye = np.broadcast_to(np.array(viewpoint.eye, np.float64), directions.shape)
    face, distance, _ = tree.intersect_ray_first(
        mesh.vertices, mesh.faces, np.ascontiguousarray(eye), directions
    )
    cosine = np.abs((normals[face] * directions).sum(axis=1))
    measured = (face >= 0) & np.isfinite(distance) & (cosine > GRAZING_COSINE)
    spread = noise / np.sqrt(cosine[measured])
    reach = distance[measured] + spread * rng.standard_normal(int(measured.sum()))
    points = eye[measured] + reach[:, None] * directions[measured]
    if mesh.colors is None:
        return points, np.zeros((len(points), 3), np.uint8)
    corners = mesh.colors[mesh.faces[face[measured], 0]].astype(np.float64)
    flicker = rng.normal(scale=5.0, size=(len(points), 1))
    return points, np.clip(corners + flicker, 0, 255).astype(np.uint8)


def _directions(viewpoint: Viewpoint, rays: int, rng: np.random.Generator) -> Floats:
    """(n, 3) unit rays on a square grid within the cone, each shifted within its cell."""
    eye, target = np.array(viewpoint.eye), np.array(viewpoint.target)
    ahead = (target - eye) / np.linalg.norm(target - eye)
    side = np.cross(ahead, [0.0, 0.0, 1.0] if abs(ahead[2]) < 0.9 else [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side)
    rows = int(np.ceil(np.sqrt(rays)))
    cell = np.stack(np.meshgrid(np.arange(rows), np.arange(rows)), axis=-1).reshape(-1, 2)
    plane = 2 * (cell + rng.random(cell.shape)) / rows - 1
    plane *= np.tan(np.radians(viewpoint.cone / 2))
    directions = ahead + plane[:, :1] * side + plane[:, 1:] * np.cross(side, ahead)
    return np.ascontiguousarray(directions / np.linalg.norm(directions, axis=1, keepdims=True))
