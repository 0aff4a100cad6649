"""Meshes of exact shells around sheets, as a fit would make them, from analytic fields."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from skimage.measure import marching_cubes

from mpf_core.cloud.neighbors import analyse
from mpf_core.fit.initialize import Initialization, initialize

Array = NDArray[np.float64]
EPSILON = 0.03
CELL = 0.02


def level(
    theta: Callable[[Array], Array], low: Array, high: Array, cell: float = CELL
) -> tuple[Array, Array]:
    """Vertices (v, 3) and faces (f, 3) of {θ = 0} in a box, its outside out."""
    low = low - 0.37 * cell  # the level itself on grid vertices would make triangles of no area
    axes = [np.arange(a, b + cell, cell) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
    values = theta(grid.reshape(-1, 3)).reshape(grid.shape[:3])
    vertices, faces, _, _ = marching_cubes(values, 0.0, spacing=(cell,) * 3)
    return vertices.astype(np.float64) + low, faces.astype(np.int64)


def shell(height: Array, beyond: Array, epsilon: float = EPSILON) -> Array:
    """The warm start's target: the outer wall on the sheet, the other 2ε below it."""
    return np.sqrt((height + epsilon) ** 2 + beyond**2) - epsilon


def square(x: Array, half: float = 0.8) -> tuple[Array, Array]:
    """Height over, and distance beyond, the square |x|, |y| ≤ half."""
    past = np.maximum(np.abs(x[:, :2]) - half, 0)
    return x[:, 2], np.linalg.norm(past, axis=1)


def start_of(points: Array) -> Initialization:
    """The warm start of a cloud on one thread, all normals up if they are alike."""
    return initialize(analyse(points, threads=1), threads=1)
