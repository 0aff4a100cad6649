"""Which parts of space the samples enclose: a flood fill of voxels that stops at discs.

Every sample is drawn as a disc in its tangent plane, large enough to close up with its
neighbours. Empty voxels reached from the corner of the box are outside; empty components that are
not reached are enclosed. Solids thinner than about three voxels have no empty voxel inside and
count as sheets.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from mpf_core.cloud.neighbors import Neighborhoods
from mpf_core.heeding import in_parts

RESOLUTION = 160  # voxels a side
HALF_BOX = 1.15  # the voxel grid covers [-HALF_BOX, HALF_BOX]³ in normalised units
SMALLEST_ENCLOSURE = 30  # voxels; smaller pockets are cracks between discs
OUTSIDE, SURFACE, INSIDE = 1, 0, -1

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FreeSpace:
    """Voxel labels: OUTSIDE, INSIDE, or SURFACE where discs are. `enclosures` counts the enclosed
    components; `regions` numbers all: 0 on discs, 1 outside, from 2 on enclosed."""

    labels: NDArray[np.int8]
    near_inside: NDArray[np.bool_]
    enclosures: int
    regions: NDArray[np.int32]

    @property
    def voxel(self) -> float:
        """Edge length of a voxel, normalised units."""
        return 2 * HALF_BOX / float(self.labels.shape[0] - 1)

    def label_at(self, x: Array) -> NDArray[np.int8]:
        """Label of the voxel that holds each point of x (n, 3)."""
        return self.labels[self._index(x)]

    def region_at(self, x: Array) -> NDArray[np.int32]:
        """Number of the region that holds each point of x (n, 3)."""
        return self.regions[self._index(x)]

    def is_near_inside(self, x: Array) -> NDArray[np.bool_]:
        """Whether each point lies in an unlabelled voxel beside enclosed space."""
        return self.near_inside[self._index(x)]

    def position(self, index: Array) -> Array:
        """Centres of voxels given by their indices (n, 3), normalised."""
        return index * self.voxel - HALF_BOX

    def _index(self, x: Array) -> tuple[NDArray[np.int64], ...]:
        size = self.labels.shape[0]
        index = np.clip(np.rint((x + HALF_BOX) / self.voxel).astype(np.int64), 0, size - 1)
        return index[:, 0], index[:, 1], index[:, 2]


def flood(
    neighbours: Neighborhoods, *, resolution: int = RESOLUTION, threads: int = -1
) -> FreeSpace:
    """Label space around the samples, which lie in [-1, 1]³."""
    occupied = draw_discs(neighbours, resolution, threads)
    component, _ = ndimage.label(~occupied)
    sizes = np.bincount(component.ravel())
    enclosed = sizes > SMALLEST_ENCLOSURE
    outer = component[0, 0, 0]
    enclosed[[0, outer]] = False
    number = np.zeros(len(sizes), dtype=np.int32)
    number[enclosed] = np.arange(2, 2 + enclosed.sum())
    number[outer] = 1
    regions = number[component]
    label = np.full(2 + int(enclosed.sum()), INSIDE, dtype=np.int8)
    label[:2] = SURFACE, OUTSIDE
    labels = label[regions]
    return FreeSpace(labels, beside_inside(labels), int(enclosed.sum()), regions)


def beside_inside(labels: NDArray[np.int8]) -> NDArray[np.bool_]:
    """Voxels of discs within three of an enclosed one."""
    near: NDArray[np.bool_] = ndimage.binary_dilation(labels == INSIDE, iterations=3)
    beside: NDArray[np.bool_] = near & (labels == SURFACE)
    return beside


def draw_discs(neighbours: Neighborhoods, resolution: int, threads: int = -1) -> NDArray[np.bool_]:
    """Voxels (resolution, ·, ·) that a disc of any sample passes."""
    occupied = np.zeros((resolution,) * 3, dtype=bool)
    voxel = 2 * HALF_BOX / (resolution - 1)
    # A lone far sample must not draw a disc across the scene.
    radius = np.minimum(neighbours.disc_radius, 3 * neighbours.median_spacing)
    second = np.cross(neighbours.normals, neighbours.tangents)
    order = np.argsort(radius)

    def draw(rows: slice) -> None:
        part = order[rows]
        # Sampled at most 0.7 voxels apart, rounded both ways: no gap a 6-neighbour flood passes.
        steps = max(3, int(np.ceil(2 * radius[part].max() / (0.7 * voxel))))
        axis = np.linspace(-1, 1, steps)
        a, b = (g.ravel() for g in np.meshgrid(axis, axis))
        keep = a**2 + b**2 <= 1.05
        for u, v in zip(a[keep], b[keep], strict=True):
            drawn = neighbours.points[part] + radius[part, None] * (
                u * neighbours.tangents[part] + v * second[part]
            )
            grid = (drawn + HALF_BOX) / voxel
            for index in (np.rint(grid), np.floor(grid)):
                i, j, k = np.clip(index.astype(np.int64), 0, resolution - 1).T
                occupied[i, j, k] = True

    in_parts(draw, len(order), threads)
    # A sheet whose discs reach the border must not part the box: the flood goes round it.
    for face in (0, -1):
        occupied[face] = occupied[:, face] = occupied[:, :, face] = False
    return occupied
