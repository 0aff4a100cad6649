"""The triangle mesh that extraction makes and export writes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Mesh:
    """Triangles in the input's frame and units.

    vertices: (v, 3) float64
    faces: (f, 3) int64, counter-clockwise seen from outside (φ > 0)
    normals: (v, 3) float64 unit vertex normals, or None
    colors: (v, 3) uint8 RGB, or None
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    normals: NDArray[np.float64] | None = None
    colors: NDArray[np.uint8] | None = None
