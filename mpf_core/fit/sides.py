"""What lies on the two sides of each sample, and from it which enclosed regions are solid.

A flood tells regions apart, not which of them are filled: what a closed surface encloses is, the
cavity within is not. Every sample of a surface is a vote that the regions on its two sides differ,
every sample of a thin wall one that the regions beyond the wall's two sides are alike.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mpf_core.cloud.neighbors import Neighborhoods
from mpf_core.fit.freespace import INSIDE, OUTSIDE, SURFACE, FreeSpace, beside_inside

STEPS = (1.5, 2.5, 4.0)  # voxels from a sample at which its sides are looked at
SPREADING = 30  # rounds in which samples that see neither side take over from their neighbours

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Sides:
    """What each sample bounds, in [0, 1]: `solid` (n,) enclosed or thin matter on one side and
    free space on the other; `buried` (n,) matter on both. A sheet in free space has neither."""

    solid: Array
    buried: Array


def parted(neighbours: Neighborhoods, space: FreeSpace) -> FreeSpace:
    """`space` with those regions labelled INSIDE that the votes of the samples say are filled."""
    if space.regions.max() < 2:
        return space
    votes = _votes(neighbours, space)
    filled = _parity(votes, int(space.regions.max()))
    label = np.where(filled, INSIDE, OUTSIDE).astype(np.int8)
    label[0] = SURFACE
    labels = np.where(space.labels == SURFACE, SURFACE, label[space.regions]).astype(np.int8)
    return replace(
        space, labels=labels, near_inside=beside_inside(labels), enclosures=int(filled.sum())
    )


def sides(neighbours: Neighborhoods, normals: Array, space: FreeSpace) -> Sides:
    """What each sample bounds; `normals` (n, 3) point outwards where that is defined."""
    outward, inward = (_label_beside(neighbours, s * normals, space) for s in (1.0, -1.0))
    layered = neighbours.layered
    enclosing = (outward != INSIDE) & (inward == INSIDE)
    between = (outward == INSIDE) & (inward == INSIDE)
    # One side unseen may be a spike too thin for the voxels: its neighbours know better.
    sheet = (outward == OUTSIDE) & (inward == OUTSIDE)
    known = layered | enclosing | between | sheet
    values = np.stack([layered | enclosing, between & ~layered], axis=1) * known[:, None]
    told = _spread(neighbours.links, values.astype(np.float64), known)
    return Sides(told[:, 0], told[:, 1])


def _label_beside(
    neighbours: Neighborhoods, direction: Array, space: FreeSpace
) -> NDArray[np.int8]:
    """The label of the first voxel along `direction` (n, 3) that is not a disc's, or SURFACE."""
    found = np.full(len(direction), SURFACE, dtype=np.int8)
    for steps in STEPS[:2]:
        there = space.label_at(neighbours.points + steps * space.voxel * direction)
        found = np.where(found == SURFACE, there, found)
    return found


def _region_beside(points: Array, direction: Array, space: FreeSpace) -> NDArray[np.int32]:
    found = np.zeros(len(points), dtype=np.int32)
    for steps in STEPS:
        there = space.region_at(points + steps * space.voxel * direction)
        found = np.where(found == 0, there, found)
    return found


def _spread(links: NDArray[np.int32], values: Array, known: NDArray[np.bool_]) -> Array:
    """`values` (n, c) with what is not known taken from the neighbours, then smoothed once."""
    weight = known.astype(np.float64)
    for _ in range(SPREADING):
        if weight.all():
            break
        around = weight[links].sum(1)
        mean = (values * weight[:, None])[links].sum(1) / np.maximum(around, 1e-12)[:, None]
        fresh = (weight == 0) & (around > 0)
        values = np.where(fresh[:, None], mean, values)
        weight = np.where(fresh, 1.0, weight)
    return np.asarray(0.5 * values + 0.5 * values[links].mean(1))


def _votes(neighbours: Neighborhoods, space: FreeSpace) -> dict[tuple[int, int], int]:
    """By pairs of regions: how many more samples say that they differ than that they are alike."""
    layered, points, normals = neighbours.layered, neighbours.points, neighbours.normals
    gap = neighbours.gap[:, None]
    there = _region_beside(points, normals, space)
    back = _region_beside(points - gap * normals, -normals, space)
    # A region within a wall, as floods find in walls of three voxels or more.
    within = np.where(layered, space.region_at(points - 0.5 * gap * normals), 0)
    votes: dict[tuple[int, int], int] = {}
    for a, b, vote in (
        (there, back, np.where(layered, -1, 1)),
        (there, within, np.ones_like(back)),
    ):
        low, high = np.minimum(a, b), np.maximum(a, b)
        told = (low > 0) & (low != high)
        pairs, number = np.unique(np.stack([low[told], high[told]]), axis=1, return_inverse=True)
        sums = np.bincount(number.ravel(), vote[told], minlength=pairs.shape[1])
        for (i, j), count in zip(pairs.T.tolist(), sums.astype(int).tolist(), strict=True):
            votes[i, j] = votes.get((i, j), 0) + count
    return votes


def _parity(votes: dict[tuple[int, int], int], regions: int) -> NDArray[np.bool_]:
    """(regions + 1,) which are filled: the strongest votes first, as far as they do not contradict
    stronger ones; 1 is outside, and so is nothing that no vote ties to it."""
    root, odd = list(range(regions + 1)), [False] * (regions + 1)

    def climb(i: int) -> tuple[int, bool]:
        differs = False
        while root[i] != i:
            differs ^= odd[i]
            i = root[i]
        return i, differs

    for (i, j), vote in sorted(votes.items(), key=lambda item: (-abs(item[1]), item[0])):
        (a, a_odd), (b, b_odd) = climb(i), climb(j)
        if a != b and vote:
            root[b], odd[b] = a, a_odd ^ b_odd ^ (vote > 0)
    outer, outer_odd = climb(1)
    filled = np.ones(regions + 1, dtype=bool)
    filled[:2] = False
    for region in range(2, regions + 1):
        top, differs = climb(region)
        filled[region] = top != outer or differs != outer_odd
    return filled
