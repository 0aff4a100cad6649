"""Noise measured and taken off: samples moved onto the plane of a neighbourhood large enough.

Where the samples scatter across the surface by as much as their spacing, neighbourhoods of fixed
size see a ball, not a plane. The neighbourhood is enlarged until it looks flat; samples are then
projected onto its weighted plane (one step of moving least squares, Levin 2003), and thinned to
the spacing that their noise allows. That is enough to find normals and sides; with those,
`smoothed` fits quadrics to the samples as they were measured, which errs half as much, and again
with the normals of these, which are better and often allow a wider kernel.
The two sides of a thin wall scatter as widely, but in two peaks: of them the spread within a side
counts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mpf_core.cloud.layers import PATCH, split
from mpf_core.cloud.neighbors import (
    CHUNK,
    SPACING_NEIGHBOUR,
    Neighborhoods,
    nearest,
    principal_axes,
)
from mpf_core.cloud.quadrics import Samples, best_kernel, fitted
from mpf_core.cloud.thinning import ANALYSED, one_of_each_voxel

SIZES = (16, 30, 50, 100, 160)  # neighbours tried
FLAT = 0.4  # median spread across over spread along the surface that counts as flat
PROBES = 2000  # samples at which sizes are judged
ROUNDS = 2
QUADRIC_ROUNDS = 4  # at most, each with the normals and the kernel that the one before allows
AT_REST = 0.02  # of the spacing: nine of ten samples move by less in a round that is the last
WIDE = 1.5  # times the noise: fits of narrower kernels follow it, and their normals would even more

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Denoised:
    """The samples as later rooms use them, in the frame given.

    points: (n, 3) projected samples; the input itself when no noise was found
    measured: (k, 3) the samples as they came, at most as many as are analysed
    thinned: (m, 3) as many of them at most, at the spacing that the noise allows
    neighbours: size of the neighbourhoods; sigma: spread of the input about the surface
    """

    points: Array
    measured: Array
    thinned: Array
    neighbours: int
    sigma: float


def denoise(
    points: Array,
    *,
    remove: bool = True,
    most: int = ANALYSED,
    seed: int = 0,
    threads: int = -1,
) -> Denoised:
    """Measure the noise of `points` (n, 3) and, if asked, take it off; clean clouds pass unchanged.

    Of a cloud of more than `most` a part is looked at, and is all that is left if it is noisy.
    """
    few = points if len(points) <= most else points[one_of_each_voxel(points, most)[0]]
    tree = cKDTree(few)
    probe = np.random.default_rng(seed).permutation(len(few))[:PROBES]
    size, sigma = _flat_neighbourhood(few, tree, probe, threads)
    if size == SIZES[0] or not remove:
        return Denoised(points, few, few, size, sigma)
    moved = few
    for _ in range(ROUNDS):
        moved = _projected(moved, size, threads)
    thinned = _thin(moved, size / SIZES[0], threads)
    return Denoised(moved, few, thinned, size, sigma)


@dataclass(frozen=True)
class Smoothed:
    """points: (m, 3); noise: spread of the measured samples about the surface through them."""

    points: Array
    noise: float


def smoothed(
    measured: Array, neighbours: Neighborhoods, normals: Array, threads: int = -1
) -> Smoothed | None:
    """The analysed points moved onto quadrics fitted to the `measured` samples (k, 3), or None if
    these lie on the surface as it is.

    `normals` (m, 3) are those of the analysed points, oriented where sides matter.
    """
    points, facing = neighbours.points, normals
    tree, spacing, scale = neighbours.tree, neighbours.spacing, neighbours.spacing
    own = np.arange(len(points))
    if measured is not points:
        tree = cKDTree(measured)
        spacing = nearest(tree, measured, SPACING_NEIGHBOUR + 1, threads)[0][:, -1]
        scale = spacing[nearest(tree, points, 1, threads)[1][:, 0]]
        own = nearest(neighbours.tree, measured, 1, threads)[1][:, 0]
    samples = Samples(measured, facing[own], tree)
    kernel = best_kernel(samples, spacing, threads)
    if kernel.exact:
        return None
    typical = float(np.median(spacing))
    for _ in range(QUADRIC_ROUNDS):
        fit = fitted(samples, points, facing, scale, kernel.size, threads)
        points, facing = points + fit.height[:, None] * fit.normals, fit.normals
        if np.percentile(np.abs(fit.height) / scale, 90) < AT_REST:
            break
        if kernel.width * typical > WIDE * kernel.noise:
            samples = replace(samples, normals=facing[own])
            kernel = best_kernel(samples, spacing, threads)
    return Smoothed(points, kernel.noise)


def _flat_neighbourhood(
    points: Array, tree: cKDTree, probe: NDArray[np.int64], threads: int
) -> tuple[int, float]:
    sizes = [size for size in SIZES if size <= len(points) // 8] or [SIZES[0]]
    best = (np.inf, sizes[0], 0.0)
    layers = split(points[nearest(tree, points[probe], min(PATCH, len(points)), threads)[1]])
    for size in sizes:
        distance, index = nearest(tree, points[probe], size, threads)
        values, _ = principal_axes(points[index], distance)
        across = np.sqrt(np.maximum(values[:, 0], 0))
        across = np.where(layers.layered, np.minimum(layers.spread, across), across)
        flatness = float(np.median(across / np.sqrt(np.maximum(values[:, 1], 1e-300))))
        # Growth must pay: curvature also stops neighbourhoods from getting flat.
        if flatness < 0.9 * best[0]:
            best = (flatness, size, float(np.median(across)))
        if flatness < FLAT:
            break
    return best[1], best[2]


def _projected(points: Array, size: int, threads: int) -> Array:
    tree, moved = cKDTree(points), np.empty_like(points)
    for start in range(0, len(points), CHUNK // 4):
        part = slice(start, start + CHUNK // 4)
        distance, index = nearest(tree, points[part], size, threads)
        patch = points[index]
        weight = np.exp(-((distance / (0.7 * np.maximum(distance[:, -1:], 1e-300))) ** 2))
        weight /= weight.sum(1, keepdims=True)
        centre = np.einsum("mk,mki->mi", weight, patch)
        normal = principal_axes(patch, distance)[1][:, :, 0]
        height = np.einsum("mi,mi->m", centre - points[part], normal)
        moved[part] = points[part] + height[:, None] * normal
    return moved


def _thin(points: Array, factor: float, threads: int) -> Array:
    """About n / factor points: the means of voxels at the matching spacing."""
    distance, _ = nearest(cKDTree(points), points, 7, threads)
    edge = float(np.median(distance[:, 6])) * np.sqrt(factor / 2)
    _, cell = np.unique(np.floor(points / edge).astype(np.int64), axis=0, return_inverse=True)
    cell = cell.ravel()
    count = np.bincount(cell)
    return np.stack([np.bincount(cell, points[:, i]) / count for i in range(3)], axis=1)
