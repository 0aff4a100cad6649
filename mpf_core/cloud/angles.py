"""How far points go round a middle."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def widest_gap(angles: Array) -> tuple[Array, Array]:
    """Middle and width (m,) of the widest arc between angles (m, k) that holds none; radians."""
    ordered = np.sort(angles, axis=1)
    gap = np.diff(np.concatenate([ordered, ordered[:, :1] + 2 * np.pi], axis=1), axis=1)
    widest = gap.argmax(1)
    rows = np.arange(len(angles))
    return ordered[rows, widest] + gap[rows, widest] / 2, gap[rows, widest]
