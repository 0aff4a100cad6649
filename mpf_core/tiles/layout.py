"""Where tiles are cut: halves of equal counts across the longest side, again and again.

By count, because that is what a fit can hold; so tiles are small where samples are dense, none is
empty, and each is about as long as wide. All lengths are normalised in the whole's frame.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from mpf_core.field.blend import Side
from mpf_core.field.partition import Cut, Partition
from mpf_core.fit.freespace import HALF_BOX, INSIDE, OUTSIDE, SURFACE, FreeSpace

RAMP = 0.06  # of the shorter of two neighbours: half of the width in which one fades into the other
LEAST_RAMP = 4.0  # spacings: what the local fits of both sides look at
# Voxels around samples, discs and invented lids in which networks are asked: beyond, no honest
# surface passes, and the whole's free space knows the side.
AROUND_SAMPLES, AROUND_DISCS, AROUND_LIDS = 2, 1, 3

Array = NDArray[np.float64]
Rows = NDArray[np.int64]


def cut_up(samples: Array, tiles: int, spacing: float) -> Partition:
    """So many tiles with as many of samples (n, 3) each, but for rounding."""
    nodes: list[tuple[int, float, float]] = []
    children: list[list[int]] = []
    leaves = 0
    # Cuts are numbered as they are met, parents before children.
    todo: list[tuple[Rows, int, tuple[int, int] | None]] = [(np.arange(len(samples)), tiles, None)]
    while todo:
        rows, count, above = todo.pop()
        if count == 1:
            number = -1 - leaves
            leaves += 1
        else:
            number = len(nodes)
            axis, at, half, parts = _halved(samples, rows, count, spacing)
            nodes.append((axis, at, half))
            children.append([0, 0])
            todo += [(parts[1], count - count // 2, (number, 1))]
            todo += [(parts[0], count // 2, (number, 0))]
        if above is not None:
            children[above[0]][above[1]] = number
    cuts = [Cut(*node, *pair) for node, pair in zip(nodes, children, strict=True)]
    return Partition(tuple(cuts), tiles)


def _halved(
    samples: Array, rows: Rows, count: int, spacing: float
) -> tuple[int, float, float, tuple[Rows, Rows]]:
    """Axis, place and half ramp of the cut through `rows`, and what lies on its two sides."""
    points = samples[rows]
    axis = int(np.ptp(points, axis=0).argmax())
    along = points[:, axis]
    order = np.argsort(along, kind="stable")
    first = len(rows) * (count // 2) // count
    at = float((along[order[first - 1]] + along[order[first]]) / 2)
    shorter = min(at - float(along.min()), float(along.max()) - at)
    half = max(RAMP * shorter, LEAST_RAMP * spacing)
    low, high = np.sort(order[:first]), np.sort(order[first:])
    return axis, at, half, (rows[low], rows[high])


def side_of(space: FreeSpace, samples: Array) -> Side:
    """The labels of the whole's free space where no network need be asked, 0 elsewhere."""
    labels = space.labels
    size = labels.shape[0]
    seen = np.zeros(labels.shape, dtype=bool)
    index = np.rint((samples + HALF_BOX) / space.voxel).astype(np.int64)
    seen[tuple(np.clip(index, 0, size - 1).T)] = True
    near = _grown(seen, AROUND_SAMPLES) | _grown(labels == SURFACE, AROUND_DISCS)
    near |= _grown(labels == INSIDE, AROUND_LIDS) & _grown(labels == OUTSIDE, AROUND_LIDS)
    return Side(np.where(near, 0, labels).astype(np.int8), HALF_BOX)


def places_near(side: Side) -> Array:
    """(k, 3) centres of the voxels in which networks are asked."""
    return np.asarray(np.argwhere(side.labels == 0) * side.voxel - side.half)


def _grown(where: NDArray[np.bool_], voxels: int) -> NDArray[np.bool_]:
    grown: NDArray[np.bool_] = ndimage.binary_dilation(where, np.ones((3, 3, 3), bool), voxels)
    return grown
