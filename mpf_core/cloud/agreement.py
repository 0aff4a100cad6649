"""Whether normals fit the samples around them.

On a smooth surface, however curved, the sum of two normals is across the line between their samples
(König and Gumhold 2009). A few neighbours are enough, since others may lie beyond a sharp edge.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# A normal fits where FITTING neighbours are within TILTED (a sine) of it, or within NOISY times
# what is usual in the cloud.
FITTING, TILTED, NOISY = 3, 0.04, 3.0

Array = NDArray[np.float64]


def fitting(points: Array, normals: Array, links: NDArray[np.int32]) -> NDArray[np.bool_]:
    """(n,) whether unit normals (n, 3) at points (n, 3), whatever their orientation, fit at the
    neighbours `links` (n, l)."""
    away = points[links] - points[:, None]
    length = np.linalg.norm(away, axis=2)
    linked = length > 0
    other = normals[links]
    side = np.sign(np.einsum("nk,nlk->nl", normals, other))[:, :, None]
    across = np.abs(np.einsum("nlk,nlk->nl", normals[:, None] + side * other, away))
    tilt = np.where(linked, across / np.where(linked, length, 1), np.inf)
    least = np.sort(tilt, axis=1)[:, FITTING - 1]
    return np.asarray(least <= max(TILTED, NOISY * float(np.median(least))))
