"""Rods: stems, wires, masts and legs whose patches reach round them.

A patch of a rod two spacings thick holds its far side too: PCA turns the normals by twenty degrees,
and no voxel lies within, so that the rod would start as a hollow tube of one layer. Here a cylinder
is fitted to each patch (its axis the direction that the normals have least in common with, its
section a circle by the algebraic fit of Kåsa 1976, its axis tilted once by what is left). Where the
circle holds the patch, the patch reaches far enough round it, and there are samples opposite, the
sample is on a rod.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mpf_core.cloud.angles import widest_gap
from mpf_core.heeding import in_parts

PATCH = 24  # neighbours that the cylinder is fitted to
ROUND = 2.0  # radians of the circle that the patch must cover; less is a fold or a rounded edge
# Of the radius: how far the patch scatters about the circle of a rod for sure, and beside such a
# rod; that of a square beam scatters by 0.1.
SURE, LEFT = 0.07, 0.11
# Spacings from the other side of the circle within which a sample must lie: a fold as tight as a
# rod is open there.
OPPOSITE = 1.0
HELD = 0.7  # share of the patch that the circle must hold; the rest may be leaf or another rod
ROUNDS = 3  # of the fit, in which what lies off the circle counts less and less
AGREE = 0.5  # share of a sample's links that must be on rods too
SPREADING = 20  # rounds in which samples beside rods join them

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True)
class Rods:
    """Samples on rods: their indices (m,), outward normals (m, 3) and the rod's radius there (m,),
    in the points' units."""

    index: Indices
    normals: Array
    radius: Array


def find_rods(
    points: Array,
    normals: Array,
    spacing: Array,
    links: NDArray[np.int32],
    tree: cKDTree,
    rows: Indices,
    threads: int = -1,
) -> Rods:
    """The rods among the samples `rows` (m,) of points (n, 3) with unit normals (n, 3), spacing
    (n,) and links (n, l) to neighbours."""
    n = len(points)
    outward, radius, left = np.zeros((n, 3)), np.zeros(n), np.full(n, np.inf)

    def look(rows_of: slice) -> None:
        part = rows[rows_of]
        index = np.asarray(tree.query(points[part], PATCH + 1)[1])
        patch = (points[index] - points[part, None]) / spacing[part, None, None]
        outward[part], size, left[part] = _cylinders(patch, normals[index])
        radius[part] = size * spacing[part]
        held = part[left[part] < LEFT]
        opposite = points[held] - 2 * radius[held, None] * outward[held]
        left[held[tree.query(opposite)[0] > OPPOSITE * spacing[held]]] = np.inf

    if n > PATCH:
        in_parts(look, len(rows), threads)
    # A few among others are an accident of their patches.
    sure = left < SURE
    sure &= sure[links].mean(1) >= AGREE
    for _ in range(SPREADING):
        sure |= (left < LEFT) & (sure[links].mean(1) >= AGREE)
    found = np.flatnonzero(sure)
    return Rods(found, outward[found], radius[found])


def _cylinders(patch: Array, normals: Array) -> tuple[Array, Array, Array]:
    """Outward normals (m, 3) at the first points of patches (m, k, 3), which are their origins, the
    radii (m,) and the scatter about them (m,), infinite where no cylinder holds the patch."""
    axes = np.linalg.eigh(normals.swapaxes(1, 2) @ normals)[1]
    axis, first = axes[:, :, 0], axes[:, :, 1]
    weight = np.ones(patch.shape[:2])
    for _ in range(ROUNDS):
        middle, radius, tilt, _ = _section(patch, axis, first, weight)
        axis, first = _framed(axis + tilt, first)
        middle, radius, _, across = _section(patch, axis, first, weight)
        out = across - middle[:, None]  # (m, k, 2)
        off = np.abs(np.linalg.norm(out, axis=2) / radius[:, None] - 1)
        weight = 1 / (1 + (off / LEFT) ** 2)
    holds = off < 2.5 * LEFT
    left = np.sqrt((off**2 * holds).sum(1) / np.maximum(holds.sum(1), 1))
    angle = np.arctan2(out[..., 1], out[..., 0])
    # A patch whose first point is not held fits nothing anyway.
    _, gap = widest_gap(np.where(holds, angle, angle[:, :1]))
    fits = (holds.mean(1) > HELD) & holds[:, 0] & (2 * np.pi - gap > ROUND)
    own = -middle / (np.linalg.norm(middle, axis=1, keepdims=True) + 1e-12)
    second = np.cross(axis, first)
    return own[:, :1] * first + own[:, 1:] * second, radius, np.where(fits, left, np.inf)


def _framed(axis: Array, first: Array) -> tuple[Array, Array]:
    axis = axis / np.linalg.norm(axis, axis=1, keepdims=True)
    first = first - (first * axis).sum(1, keepdims=True) * axis
    return axis, first / np.linalg.norm(first, axis=1, keepdims=True)


def _section(
    patch: Array, axis: Array, first: Array, weight: Array
) -> tuple[Array, Array, Array, Array]:
    """The circle that fits patches (m, k, 3) seen along `axis` (m, 3): its middle (m, 2), its
    radius (m,), the tilt (m, 3) of the axis by which its middle wanders along it, and the patches
    across the axis (m, k, 2)."""
    second = np.cross(axis, first)
    across = np.stack([(patch @ d[..., None])[..., 0] for d in (first, second)], axis=2)
    along = (patch @ axis[..., None])[..., 0]
    ones = np.ones_like(along)
    terms = np.concatenate(
        [2 * across, ones[..., None], 2 * across * along[..., None], along[..., None]], axis=2
    )
    turned = (terms * weight[..., None]).swapaxes(1, 2)
    gram = turned @ terms + 1e-6 * np.eye(6)
    fitted = np.linalg.solve(gram, turned @ (across**2).sum(2)[..., None])[..., 0]
    middle = fitted[:, :2]
    radius = np.sqrt(np.maximum(fitted[:, 2] + (middle**2).sum(1), 1e-300))
    return middle, radius, fitted[:, 3:4] * first + fitted[:, 4:5] * second, across
