"""What keeps a surface within the grid around the box that the field was fitted in.

Where samples are missing a field may bulge out of it, and marching cubes would leave a hole in its
side. There the surface ends at the side itself, as if everything beyond were outside.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mpf_core.surface.isosurface import Isosurface
from mpf_core.surface.lattice import Evaluate, Grid

Array = NDArray[np.float64]

PROBES = 64  # along each edge of a side
# Share of the grid's sides, by area, that is taken for an accident. More, as where a sheet parts
# the box in two because no side of it was told, says that outside is not what it seems.
ACCIDENT = 0.05
BESIDE = 1e-6  # cells from a side within which a vertex is on it


def leaves(surface: Isosurface) -> bool:
    """Whether the surface, a mesh in the grid's frame, ends at a side of the grid."""
    grid, x = surface.grid, surface.vertices
    low, high = x.min(0) - grid.origin, grid.points(grid.shape) - x.max(0)
    return bool((np.minimum(low, high) < BESIDE * grid.steps).any())


def kept_within(level: Evaluate, grid: Grid, negative: float) -> Evaluate | None:
    """`level` with all that is beyond the grid's sides outside, half a cell early; None where the
    two signs share the sides, `negative` being one's share, in such a way that outside cannot be
    told."""
    low, high = grid.origin, grid.points(grid.shape)
    if ACCIDENT < negative < 1 - ACCIDENT:
        return None
    sign = 1 if negative < 0.5 else -1

    def within(x: Array) -> NDArray[np.float32]:
        beyond = np.maximum(low + grid.steps / 2 - x, x - high + grid.steps / 2).max(1)
        return np.asarray(sign * np.maximum(sign * level(x), beyond.astype(np.float32)))

    return within


def negative_share(level: Evaluate, grid: Grid) -> float:
    """The share of the grid's sides, by area, where `level` is negative."""
    low, high = grid.origin, grid.points(grid.shape)
    axis = (np.arange(PROBES) + 0.5) / PROBES
    across = np.stack(np.meshgrid(axis, axis, indexing="ij"), -1).reshape(-1, 2)
    area = np.prod(high - low) / (high - low)  # of the sides across each axis
    shares = [
        (level(low + np.insert(across, k, end, axis=1) * (high - low)) < 0).mean()
        for k in range(3)
        for end in (0.0, 1.0)
    ]
    return float(np.average(shares, weights=np.repeat(area, 2)))
