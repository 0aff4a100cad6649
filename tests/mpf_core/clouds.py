"""Clouds with known surfaces, for the tests of several rooms."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mpf_core.experiments.shapes import shape
from mpf_core.quality.sampling import sample_surface
from mpf_core.surface.normals import face_normals

Array = NDArray[np.float64]

GOLDEN = np.pi * (3 - np.sqrt(5))


def sphere(count: int, radius: float = 1.0, noise: float = 0.0, seed: int = 0) -> Array:
    """(count, 3) evenly spread over a sphere about the origin, with Gaussian noise."""
    z = 1 - (2 * np.arange(count) + 1) / count
    angle = GOLDEN * np.arange(count)
    ring = np.sqrt(1 - z * z)
    points = radius * np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)
    return points + noise * np.random.default_rng(seed).normal(size=(count, 3))


def plane(side: int, tilt: float = 0.0, jitter: float = 0.3, seed: int = 0) -> Array:
    """(side², 3) over [-1, 1]² at z = tilt·x, each moved by a share of the spacing."""
    axis = np.linspace(-1, 1, side)
    x, y = (g.ravel() for g in np.meshgrid(axis, axis))
    moved = np.random.default_rng(seed).uniform(-1, 1, size=(2, side * side)) * jitter / side
    x, y = x + moved[0], y + moved[1]
    return np.stack([x, y, tilt * x], axis=1)


def ball(count: int, seed: int = 0) -> Array:
    """(count, 3) uniform in the unit ball: no surface at all."""
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return direction * rng.uniform(size=(count, 1)) ** (1 / 3)


def sampled(name: str, count: int, noise: float = 0.0) -> tuple[Array, Array]:
    """Points and the exact normals there."""
    mesh, rng = shape(name), np.random.default_rng(0)
    drawn = sample_surface(mesh, count, rng)
    moved = drawn.points + rng.normal(size=drawn.points.shape) * noise
    return moved, face_normals(mesh)[drawn.faces]
