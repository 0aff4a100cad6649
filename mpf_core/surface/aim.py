"""Where the data want the vertices of a mesh: what their patches say together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mpf_core.cloud.neighbors import nearest
from mpf_core.heeding import in_parts
from mpf_core.surface.patches import NEIGHBOURS, Patches, pull

STEPS = 2  # moves onto the surface; the second is already a tenth of the first

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Aim:
    """Where the data want the vertices: step (v, 3), already weighted by trust; outward (v, 3);
    front, trust, offset, spacing: (v,); back: (v,) bool, of the second wall of a shell."""

    step: Array
    outward: Array
    front: Array
    trust: Array
    offset: Array
    spacing: Array

    @property
    def back(self) -> NDArray[np.bool_]:
        return np.asarray(self.front < 0.5)


def aim_at(patches: Patches, vertices: Array, directions: Array, threads: int = -1) -> Aim:
    """Where the patches want vertices (v, 3) with unit outward directions (v, 3)."""
    count = len(vertices)
    step, outward = np.empty((count, 3)), np.empty((count, 3))
    front, trust, offset, spacing = (np.empty(count) for _ in range(4))

    def work(part: slice) -> None:
        x, facing = vertices[part], directions[part]
        index = nearest(patches.tree, x, min(NEIGHBOURS, len(patches.points)), 1)[1]
        first = pull(patches, x, facing, index)
        trust[part], front[part], offset[part] = first.trust, first.front, first.height
        spacing[part] = patches.spacing[index[:, 0]]
        y = x + first.step
        for _ in range(STEPS - 1):
            y = y + pull(patches, y, facing, index).step
        step[part] = first.trust[:, None] * (y - x)
        outward[part] = first.outward

    in_parts(work, count, threads)
    return Aim(step, outward, front, trust, offset, spacing)
