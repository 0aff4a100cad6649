"""The cloud as every later room receives it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class PointCloud:
    """Points with what the file said about them, in the input's units and frame.

    points: (n, 3) float64
    normals: (n, 3) float64, unit, as the file gave them (orientation not trusted), or None
    colors: (n, 3) uint8 RGB, or None
    notes: what the reader decided, in sentences for the report ("faces skipped", "column 4 read
        as intensity").
    """

    points: NDArray[np.float64]
    normals: NDArray[np.float64] | None = None
    colors: NDArray[np.uint8] | None = None
    notes: tuple[str, ...] = field(default=())

    def __len__(self) -> int:
        return len(self.points)
