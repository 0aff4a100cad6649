"""Fewer samples, where there are more than a fit can tell apart: one of each occupied voxel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mpf_core.heeding import heed

# Their spacing on a normalised surface is about 0.008, below what the field's network resolves;
# analysing them takes seconds and some 200 MiB.
ANALYSED = 200_000
ROUNDS = 5
FEW = 0.5  # share of the wanted number below which a smaller pitch is tried

Array = NDArray[np.float64]


def one_of_each_voxel(points: Array, most: int) -> tuple[NDArray[np.int64], float]:
    """Ascending indices of at most `most` of `points` (n, 3), denser parts thinned more, and the
    side of the voxels that share one (0: none do).

    Samples are kept, never averaged: the two sides of a thin wall may share a voxel.
    """
    if len(points) <= most:
        return np.arange(len(points)), 0.0
    low = points.min(0)
    pitch = float((points - low).max()) / np.sqrt(most)
    best: tuple[NDArray[np.int64], float] | None = None
    rounds = 0
    while best is None or (rounds < ROUNDS and len(best[0]) < FEW * most):
        heed()
        rounds += 1
        cells = np.floor((points - low) / pitch).astype(np.int64)
        keys = (cells[:, 0] << 42) + (cells[:, 1] << 21) + cells[:, 2]
        first = np.unique(keys, return_index=True)[1]
        if len(first) <= most and (best is None or len(first) > len(best[0])):
            best = np.sort(first), pitch
        # Voxels that a surface crosses go with the square of the pitch; 5 % ends the search soon.
        pitch *= 1.05 * np.sqrt(len(first) / most)
    return best
