"""Bodies whose samples have holes: enclosed space by generalised winding numbers.

A flood leaks through any hole wider than the discs. The winding number of the oriented samples
(Jacobson et al. 2013; for points Barill et al. 2018) is near ±1 inside a body even so. A region
where it exceeds one half counts as enclosed only if little of its boundary is invented, that is,
lies where there are no samples: the mouth of a bowl is large against the bowl, a gap in a scan is
small against the body.
"""

from __future__ import annotations

from dataclasses import replace

import igl
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from mpf_core.cloud.neighbors import DISC_NEIGHBOUR, Neighborhoods
from mpf_core.fit.freespace import INSIDE, OUTSIDE, SMALLEST_ENCLOSURE, FreeSpace, beside_inside

COARSE = 3  # voxels per evaluation of the winding number, along each axis
INVENTED = 0.12  # largest share of the boundary without samples
SHARP = 0.7  # winding number that the middle of a body must reach

Array = NDArray[np.float64]


def close_gaps(neighbours: Neighborhoods, normals: Array, space: FreeSpace) -> FreeSpace:
    """`space` with the regions that the oriented samples wind around labelled INSIDE."""
    empty = space.labels == OUTSIDE
    winding = np.abs(_winding(neighbours, normals, space))
    component, _ = ndimage.label(empty & (winding > 0.5))
    labels = space.labels.copy()
    found = 0
    for number, place in enumerate(ndimage.find_objects(component), start=1):
        around = tuple(slice(max(s.start - 1, 0), s.stop + 1) for s in place)
        region = component[around] == number
        if region.sum() <= SMALLEST_ENCLOSURE or winding[around][region].max() < SHARP:
            continue
        if _invented_share(region, empty[around]) <= INVENTED:
            labels[around][region] = INSIDE
            found += 1
    if not found:
        return space
    return replace(
        space, labels=labels, near_inside=beside_inside(labels), enclosures=space.enclosures + found
    )


def _winding(neighbours: Neighborhoods, normals: Array, space: FreeSpace) -> NDArray[np.float32]:
    """The winding number at every voxel, evaluated at every third and interpolated."""
    size = space.labels.shape[0]
    axis = np.linspace(0, size - 1, -(-size // COARSE))
    grid = space.position(np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3))
    area = np.pi * neighbours.disc_radius**2 / DISC_NEIGHBOUR
    values = igl.fast_winding_number(neighbours.points, normals, area, grid)
    coarse = values.reshape((len(axis),) * 3).astype(np.float32)
    fine: NDArray[np.float32] = ndimage.zoom(coarse, size / len(axis), order=1, grid_mode=False)
    return fine[:size, :size, :size]


def _invented_share(region: NDArray[np.bool_], empty: NDArray[np.bool_]) -> float:
    """Share of the region's boundary that faces empty voxels rather than drawn discs."""
    invented = total = 0
    for axis in range(3):
        for side in (1, -1):
            beyond = ndimage.shift(region, _step(axis, -side), order=0, cval=0).astype(bool)
            face = beyond & ~region
            total += int(face.sum())
            invented += int((face & empty).sum())
    return invented / max(total, 1)


def _step(axis: int, side: int) -> tuple[int, int, int]:
    step = [0, 0, 0]
    step[axis] = side
    return step[0], step[1], step[2]
