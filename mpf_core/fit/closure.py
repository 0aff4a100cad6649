"""Bodies whose samples have holes: enclosed space by generalised winding numbers.

A flood leaks through any hole wider than the discs. The winding number of the oriented samples
(Jacobson et al. 2013; for points Barill et al. 2018) is near ±1 inside a body even so. A region
where it exceeds one half counts as enclosed only if little of its boundary is invented, that is,
lies where there are no samples: the mouth of a bowl is large against the bowl, a gap in a scan is
small against the body. And the invented part, the lid, must go on where the surface ends: round a
gap the surface runs towards the lid's middle, at the lip of a vase past it or away.
"""

from __future__ import annotations

from dataclasses import replace

import igl
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, sparse
from scipy.sparse import csgraph
from scipy.spatial import cKDTree

from mpf_core.cloud.neighbors import DISC_NEIGHBOUR, Neighborhoods, nearest
from mpf_core.fit.freespace import (
    INSIDE,
    OUTSIDE,
    SMALLEST_ENCLOSURE,
    SURFACE,
    FreeSpace,
    beside_inside,
)
from mpf_core.heeding import heed

COARSE = 3  # voxels per evaluation of the winding number, along each axis
INVENTED = 0.12  # largest share of the boundary without samples
LITTLE = 0.02  # share up to which a lid may also stand across the surface, as where feet are cut
CRACK = 0.01  # share up to which a lid is a crack between discs, whatever the surface does there
# Least mean cosine between the end of the surface and the lid.
TOWARDS, ACROSS = 0.35, -0.3
# Voxels and spacings from a sample within which its normal tells the side.
NEAR, PAST = 1.5, 0.9
MANY = 100_000  # samples from which a tree over all of them takes seconds
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
        lid, share = _lid(region, empty[around])
        corner = np.array([s.start for s in around], dtype=np.float64)
        if share > INVENTED:
            continue
        course = _course(neighbours, space.position(np.argwhere(lid) + corner), space.voxel)
        if share <= CRACK or course >= (ACROSS if share <= LITTLE else TOWARDS):
            labels[around][region] = INSIDE
            found += 1
    if not found:
        return space
    return replace(
        space,
        labels=labels,
        near_inside=beside_inside(labels),
        enclosures=space.enclosures + found,
    )


def settle(
    neighbours: Neighborhoods, normals: Array, solid: NDArray[np.bool_], space: FreeSpace
) -> FreeSpace:
    """`space` with the voxels labelled that discs fill although no sample is near.

    Beside a solid the winding number of its samples tells the side; discs reach past edges and
    rims, where the side that a normal suggests is worth nothing. `solid` (n,): which bound one.
    """
    index = np.argwhere(space.labels == SURFACE)
    at = space.position(index.astype(np.float64))
    distance, closest = nearest(neighbours.tree, at, 1)
    far = np.maximum(NEAR * space.voxel, PAST * neighbours.spacing[closest[:, 0]])
    doubtful = (distance[:, 0] > far) & solid[closest[:, 0]]
    if not doubtful.any():
        return space
    winding = _winding_at(at[doubtful], neighbours, normals, space.voxel, solid)
    labels = space.labels.copy()
    labels[tuple(index[doubtful].T)] = np.where(winding > 0.5, INSIDE, OUTSIDE)
    return replace(space, labels=labels, near_inside=beside_inside(labels))


def _winding(neighbours: Neighborhoods, normals: Array, space: FreeSpace) -> NDArray[np.float32]:
    """The winding number at every voxel, evaluated at every third and interpolated."""
    size = space.labels.shape[0]
    axis = np.linspace(0, size - 1, -(-size // COARSE))
    grid = space.position(np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3))
    every = np.ones(len(normals), dtype=bool)
    values = _winding_at(grid, neighbours, normals, space.voxel, every)
    coarse = values.reshape((len(axis),) * 3).astype(np.float32)
    fine: NDArray[np.float32] = ndimage.zoom(coarse, size / len(axis), order=1, grid_mode=False)
    return fine[:size, :size, :size]


def _winding_at(
    x: Array, neighbours: Neighborhoods, normals: Array, voxel: float, which: NDArray[np.bool_]
) -> Array:
    """(m,) the winding number at x (m, 3) of those samples `which` (n,), each a disc of its share
    of the surface."""
    heed()
    points = neighbours.points[which]
    area = np.pi * neighbours.disc_radius[which] ** 2 / DISC_NEIGHBOUR
    discs = normals[which] * area[:, None]
    if len(points) > MANY:
        points, discs = _merged(points, discs, area, voxel)
    size = np.linalg.norm(discs, axis=1)
    facing = discs / np.maximum(size, 1e-300)[:, None]
    return np.asarray(igl.fast_winding_number(points, facing, size, x))


def _merged(points: Array, discs: Array, area: Array, voxel: float) -> tuple[Array, Array]:
    """Those discs (n, 3) that share a voxel and a side as one, at their middle: what is asked for
    lies on a coarser grid, and from two voxels on they look the same."""
    cell = np.floor((points - points.min(0)) / voxel).astype(np.int64)
    largest = np.abs(discs).argmax(1)
    facing = np.take_along_axis(discs, largest[:, None], axis=1)[:, 0] > 0
    _, own = np.unique(2 * (cell @ (1, 1 << 20, 1 << 40)) + facing, return_inverse=True)
    total = np.bincount(own, area)

    def added(values: Array) -> Array:
        return np.stack([np.bincount(own, values[:, i]) for i in range(3)], axis=1).astype(float)

    return added(points * area[:, None]) / total[:, None], added(discs)


def _lid(region: NDArray[np.bool_], empty: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], float]:
    """Empty voxels that the region ends at, and their share of its boundary."""
    lid = np.zeros_like(region)
    invented = total = 0
    for axis in range(3):
        for side in (1, -1):
            beyond = ndimage.shift(region, _step(axis, -side), order=0, cval=0).astype(bool)
            face = beyond & ~region
            total += int(face.sum())
            invented += int((face & empty).sum())
            lid |= face & empty
    return lid, invented / max(total, 1)


def _course(neighbours: Neighborhoods, lid: Array, voxel: float) -> float:
    """Mean cosine between the directions in which the data end at the lid (k, 3) and those to the
    middle of its piece; 1 where nothing ends there."""
    if not len(lid):
        return 1.0
    tree = cKDTree(lid)
    pairs = tree.query_pairs(2 * voxel, output_type="ndarray")
    links = sparse.coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), (len(lid),) * 2)
    _, piece = csgraph.connected_components(links, directed=False)
    size = np.bincount(piece)
    middle = np.stack([np.bincount(piece, lid[:, i]) / size for i in range(3)], axis=1)
    # What nothing around confirms, such as an outlier, ends no surface.
    ends = np.flatnonzero(neighbours.rim.any(1) & neighbours.consistent)
    # The lid begins where the discs of the samples end.
    reach = 2 * voxel + neighbours.disc_radius[ends] + neighbours.spacing[ends]
    # An end counts for the largest piece near it: between a lid and its rim there may be crumbs.
    heed()
    at = tree.query_ball_point(neighbours.points[ends], reach)
    found = [(end, piece[voxels]) for end, voxels in zip(ends, at, strict=True) if voxels]
    if not found:
        return 1.0
    ends = np.array([end for end, _ in found])
    piece_of = np.array([pieces[size[pieces].argmax()] for _, pieces in found])
    towards = middle[piece_of] - neighbours.points[ends]
    towards /= np.linalg.norm(towards, axis=1, keepdims=True) + 1e-12
    cosine = np.einsum("ni,ni->n", neighbours.rim[ends], towards)
    # By pieces, each as large as it is: a wide lid counts for more than many small ones.
    count = np.bincount(piece_of, minlength=len(size))
    mean = np.bincount(piece_of, cosine, minlength=len(size)) / np.maximum(count, 1)
    weight = size * (count > 0)
    return float((mean * weight).sum() / weight.sum())


def _step(axis: int, side: int) -> tuple[int, int, int]:
    step = [0, 0, 0]
    step[axis] = side
    return step[0], step[1], step[2]
