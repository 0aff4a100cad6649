"""What extraction must know of the samples, small enough to be kept beside the field.

Lengths are in normalised units ([-1, 1]³).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mpf_core.cloud.thinning import one_of_each_voxel

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
        kept, pitch = one_of_each_voxel(samples, most)
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
