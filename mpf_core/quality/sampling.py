"""Points on a mesh, uniform in area."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mpf_core.surface.mesh import Mesh
from mpf_core.surface.normals import face_areas


@dataclass(frozen=True)
class SurfaceSamples:
    """points: (n, 3) float64; faces: (n,) int64, the triangle each point lies on."""

    points: NDArray[np.float64]
    faces: NDArray[np.int64]


def sample_surface(
    mesh: Mesh, count: int, rng: np.random.Generator, *, stratified: bool = False
) -> SurfaceSamples:
    """`count` points uniform in area; `stratified` draws one from each of `count` equal areas.

    Stratification keeps the distribution and lowers the variance of means over the samples.
    """
    cumulative = np.cumsum(face_areas(mesh))
    if count > 0 and (len(cumulative) == 0 or cumulative[-1] <= 0):
        raise ValueError("a mesh without area cannot be sampled")
    where = rng.random(count)
    if stratified:
        where = (np.arange(count) + where) / count
    chosen = np.searchsorted(cumulative, where * cumulative[-1], side="right")
    chosen = np.minimum(chosen, len(cumulative) - 1)
    u, v = rng.random((2, count))
    root = np.sqrt(u)
    weights = np.stack([1 - root, root * (1 - v), root * v], axis=1)
    points = np.einsum("nk,nkd->nd", weights, mesh.vertices[mesh.faces[chosen]])
    return SurfaceSamples(points, chosen.astype(np.int64))
