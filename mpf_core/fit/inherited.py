"""The warm start of a tile, whose sides are those of the whole cloud.

A part of a surface encloses nothing, and each part for itself may take either side of a sheet for
the outer one: fields of opposite sign cannot be blended. So normals, what samples bound and the
labels of free space are taken from the classical start of the whole; distances are the tile's own.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mpf_core.cloud.neighbors import CHUNK, Neighborhoods, nearest
from mpf_core.fit.closure import NEAR, PAST
from mpf_core.fit.freespace import (
    HALF_BOX,
    INSIDE,
    OUTSIDE,
    RESOLUTION,
    SURFACE,
    FreeSpace,
    beside_inside,
    draw_discs,
)
from mpf_core.fit.initialize import Facing, Initialization
from mpf_core.fit.localfit import LocalFit
from mpf_core.fit.orientation import HINT, orient
from mpf_core.fit.sides import Sides

ASKED = 3  # samples of the whole that must agree on the side of one of the tile
SURE = 0.5  # cosine of the normals from which they have a say
TOLD = 20.0  # links: a side that the whole tells goes before all those of a sample

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Phase:
    """The whole's start around a tile, in the frame of the tile.

    points, normals: (m, 3) the whole's analysed samples, oriented; solid, buried: (m,) as in
    `Sides`; labels: (i, j, k) int8 as in `FreeSpace`, at voxels of edge `voxel` of which the first
    lies at `corner` (3,); shell: ε; enclosures: of the whole
    """

    points: Array
    normals: Array
    solid: Array
    buried: Array
    labels: NDArray[np.int8]
    corner: Array
    voxel: float
    shell: float
    enclosures: int

    @cached_property
    def tree(self) -> cKDTree:
        """Of the points."""
        return cKDTree(self.points)

    def label_at(self, x: Array) -> NDArray[np.int8]:
        """(n,) the label of the voxel nearest to each point of x (n, 3)."""
        index = np.rint((x - self.corner) / self.voxel)
        last = np.array(self.labels.shape) - 1
        i, j, k = np.clip(index, 0, last).astype(np.int64).T
        return np.asarray(self.labels[i, j, k])


def faced(neighbours: Neighborhoods, phase: Phase, *, threads: int = -1) -> Facing:
    """Which way the samples of a tile face, as the whole's."""
    count = min(ASKED, len(phase.points))
    _, index = nearest(phase.tree, neighbours.points, count, threads)
    return Facing(None, orient(neighbours, _seeds(neighbours, phase.normals[index])))


def inherited(
    neighbours: Neighborhoods,
    phase: Phase,
    first: Facing | None = None,
    *,
    threads: int = -1,
) -> Initialization:
    """The classical start of a tile from its neighbourhoods in [-1, 1]³ and the whole's phase.
    `first` is how they are `faced`, where that is known already."""
    normals = (first or faced(neighbours, phase, threads=threads)).normals
    closest = nearest(phase.tree, neighbours.points, 1, threads)[1][:, 0]
    layered = neighbours.layered
    solid = np.where(layered, 1.0, phase.solid[closest])
    bounds = Sides(solid, np.where(layered, 0.0, phase.buried[closest]))
    local = LocalFit(neighbours, normals, threads, solid > 0.5)
    space = _space(neighbours, local, solid > 0.5, phase)
    return Initialization(local, space, normals, float((solid > 0.5).mean()), phase.shell, bounds)


def _seeds(neighbours: Neighborhoods, normals: Array) -> Array:
    """(n,) sides by the nearest normals (n, k, 3) of the whole, 0 where these are not of one mind;
    there samples of thin walls face away from the other side, as a hint."""
    cosine = np.einsum("nki,ni->nk", normals, neighbours.normals)
    agreed = (cosine > SURE).all(1).astype(np.float64) - (cosine < -SURE).all(1)
    return np.where(neighbours.layered & (agreed == 0), HINT, TOLD * agreed)


def _space(
    neighbours: Neighborhoods, local: LocalFit, solid: NDArray[np.bool_], phase: Phase
) -> FreeSpace:
    """The whole's labels on voxels of the tile, and where it knows none, for its discs are there,
    but no sample of the tile is near, the side that the samples have."""
    labels = np.empty((RESOLUTION,) * 3, dtype=np.int8)
    voxel = 2 * HALF_BOX / (RESOLUTION - 1)
    places: Array = np.argwhere(np.ones((1, RESOLUTION, RESOLUTION))).astype(np.float64)
    for i in range(RESOLUTION):
        at = (places + np.array([i, 0, 0])) * voxel - HALF_BOX
        labels[i] = phase.label_at(at).reshape(RESOLUTION, RESOLUTION)
    doubtful = np.argwhere(draw_discs(neighbours, RESOLUTION, local.threads) | (labels == SURFACE))
    for start in range(0, len(doubtful), CHUNK):
        index = doubtful[start : start + CHUNK]
        at = index.astype(np.float64) * voxel - HALF_BOX
        distance, closest = (a[:, 0] for a in nearest(neighbours.tree, at, 1, local.threads))
        found = labels[tuple(index.T)]
        near = distance <= np.maximum(NEAR * voxel, PAST * neighbours.spacing[closest])
        found[near] = SURFACE
        found[(found == SURFACE) & ~near & ~solid[closest]] = OUTSIDE
        open_ = np.flatnonzero((found == SURFACE) & ~near)
        if len(open_):
            found[open_] = np.where(local.at(at[open_]).signed < 0, INSIDE, OUTSIDE)
        labels[tuple(index.T)] = found
    regions = np.zeros((1, 1, 1), dtype=np.int32)  # nobody asks for those of a tile
    return FreeSpace(labels, beside_inside(labels), phase.enclosures, regions)
