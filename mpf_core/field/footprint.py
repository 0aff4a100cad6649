"""What extraction must know of the samples, small enough to be kept beside the field.

Lengths are in normalised units ([-1, 1]³).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

MOST = 65_536  # samples kept: 590 kB with colours, which leaves the weights room within 2 MiB
STEP = 2 / 65_535  # of the lattice that positions are rounded to: a hundredth of a fine spacing

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Footprint:
    """A thinned, rounded copy of the samples, and the lengths that extraction takes from them.

    The first extraction uses it as every later one does, so that all find the same pieces.

    lattice: (m, 3) uint16, the kept samples in steps from the corner (-1, -1, -1)
    colors: (m, 3) uint8 RGB of the kept samples, or None
    cover: every sample lies within this distance of a kept one
    spacing: median spacing of the samples
    reach: the same of those that the field was fitted to, noise taken off and thinned
    thickness: of the shell that was put around open sheets, None if there were none
    """

    lattice: NDArray[np.uint16]
    colors: NDArray[np.uint8] | None
    cover: float
    spacing: float
    reach: float
    thickness: float | None

    @classmethod
    def of(
        cls,
        samples: Array,
        *,
        spacing: float,
        reach: float,
        thickness: float | None,
        colors: NDArray[np.uint8] | None = None,
        most: int = MOST,
    ) -> Footprint:
        """Of samples (n, 3) in [-1, 1]³: all of them, or the first in each voxel if too many."""
        kept, pitch = _thinned(samples, most)
        rounded = np.rint((samples[kept] + 1) / STEP)
        lattice = np.clip(rounded, 0, 65_535).astype(np.uint16)
        cover = np.sqrt(3) * (pitch + STEP / 2)
        picked = None if colors is None else np.ascontiguousarray(colors[kept])
        return cls(lattice, picked, float(cover), spacing, reach, thickness)

    @cached_property
    def points(self) -> Array:
        """(m, 3) the kept samples."""
        return self.lattice.astype(np.float64) * STEP - 1

    @cached_property
    def tree(self) -> cKDTree:
        """KD-tree of `points`."""
        return cKDTree(self.points)


def _thinned(samples: Array, most: int) -> tuple[NDArray[np.int64], float]:
    """Indices of at most `most` samples, and the side of the voxels that share one (0: none do)."""
    if len(samples) <= most:
        return np.arange(len(samples)), 0.0
    pitch = 2 / np.sqrt(most)
    while True:
        cells = np.floor((samples + 1) / pitch).astype(np.int64)
        keys = (cells[:, 0] << 42) + (cells[:, 1] << 21) + cells[:, 2]
        first = np.unique(keys, return_index=True)[1]
        if len(first) <= most:
            return np.sort(first), float(pitch)
        # Voxels that a surface crosses go with the square of the pitch; 5 % ends the search soon.
        pitch *= 1.05 * np.sqrt(len(first) / most)
