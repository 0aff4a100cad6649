"""The data as small quadric patches that pull vertices: moving least squares, one wall at a time.

Each sample pᵢ has a patch hᵢ(x) = nᵢ·(x − pᵢ) − ½ (x − pᵢ)ᵀKᵢ(x − pᵢ), fitted to the samples around
it that face its way. A vertex x with outward direction g is pulled by the patches near it, weighted
by wᵢ ∝ exp(−|x − pᵢ|²/2h² − |nᵢ − g|²/σ²) (the normals' part after Öztireli et al. 2009): across an
edge, or through a thin wall, patches of the other side have no say. A sample of an open sheet has
two patches, its own and one that faces back a thickness t behind it, so that each wall of the shell
around a sheet has its own.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mpf_core.cloud.neighbors import Neighborhoods
from mpf_core.cloud.quadrics import FACING, Samples, best_kernel, fitted

NEIGHBOURS = 16  # patches that may pull a vertex; half of them can be the other side of a wall
BLEND = 0.45  # h over the local spacing
ROUNDS = 3  # of fitting: each turns the normals, which says anew who faces the same way

Array = NDArray[np.float64]
Single = NDArray[np.float32]
Indices = NDArray[np.int64]


@dataclass(frozen=True)
class Patches:
    """n patches. points, normals: (n, 3); curvature: (n, 3, 3) K; spacing: (n,) local;
    sheet: (n,) 1 for a patch of an open sheet, −1 for one of a sheet inside a solid, whose shell is
    empty and has its faces the other way round, 0 for solids; thickness: t of the shells;
    kernel: of the fits, over the spacing; deviation: standard error of a patch's height, from how
    well its neighbours predict it."""

    points: Single
    tree: cKDTree
    normals: Single
    curvature: Single
    spacing: Single
    sheet: NDArray[np.int8]
    thickness: float
    kernel: float
    deviation: float


@dataclass(frozen=True)
class Pull:
    """What the patches want of m vertices.

    step: (m, 3) to the surface; outward: (m, 3) normal there, not of unit length where patches
    disagree; trust: (m,) in [0, 1], 0 far from data or where none faces the vertex's way;
    front: (m,) share of patches that are samples' own; height: (m,) signed, over those.
    """

    step: Single
    outward: Single
    trust: Single
    front: Single
    height: Single


def patches_of(
    cloud: Neighborhoods,
    normals: Array,
    sheet: NDArray[np.int8],
    thickness: float,
    threads: int = -1,
) -> Patches:
    """The patches of a cloud with oriented `normals` (n, 3); `sheet` (n,) as in Patches.

    The kernel is the one with which neighbours predict left-out samples best; samples that are not
    exact, but scatter about the surface, move onto their patches.
    """
    samples = Samples(cloud.points, normals, cloud.tree)
    kernel = best_kernel(samples, cloud.spacing, threads)
    for _ in range(ROUNDS):
        fit = fitted(samples, cloud.points, samples.normals, cloud.spacing, kernel.size, threads)
        samples = replace(samples, normals=fit.normals)
    points, tree = cloud.points, cloud.tree
    if not kernel.exact:
        points = points + fit.height[:, None] * fit.normals
        tree = cKDTree(points)
    single = (a.astype(np.float32) for a in (points, fit.normals, fit.curvature, cloud.spacing))
    p, n, k, s = single
    return Patches(p, tree, n, k, s, sheet, thickness, kernel.width, kernel.deviation)


def pull(patches: Patches, x: Array, direction: Array, index: Indices) -> Pull:
    """The pull of the patches `index` (m, k) on x (m, 3) with unit outward `direction` (m, 3)."""
    normals, kind = patches.normals[index], patches.sheet[index]
    sheet = kind != 0
    offset = x.astype(np.float32)[:, None] - patches.points[index]
    spacing = patches.spacing[index[:, 0]]
    facing = np.einsum("mki,mi->mk", normals, direction.astype(np.float32))
    square = np.einsum("mki,mki->mk", offset, offset)
    facing *= np.where(kind < 0, np.float32(-1), np.float32(1))
    agree = np.where(sheet, np.abs(facing), facing)
    log_weight = -square / (2 * (BLEND * spacing[:, None]) ** 2) - 2 * (1 - agree) / FACING**2
    weight = np.exp(log_weight - log_weight.max(1, keepdims=True))
    weight /= weight.sum(1, keepdims=True)
    front = np.where(sheet, smoothstep(0.5 * (1 + facing / 0.7)), np.float32(1))
    bend = np.einsum("mkij,mkj->mki", patches.curvature[index], offset)
    height = np.einsum("mki,mki->mk", normals - 0.5 * bend, offset)
    slope = normals - bend
    mean = np.einsum("mk,mki->mi", weight, slope)
    length = np.einsum("mi,mi->m", mean, mean)
    wanted = weight * (height + (1 - front) * np.float32(patches.thickness))
    # Divided by |Σ w n|², one step leads to an edge between patches as it does to a single one.
    step = -np.einsum("mk,mki->mi", wanted, slope) / np.maximum(length, 0.3)[:, None]
    turn = np.where(kind < 0, 1 - 2 * front, 2 * front - 1)
    outward = np.einsum("mk,mki->mi", weight * turn, slope)
    # The second wall of a shell may be farther behind the data than the data are apart.
    aside = square - np.where(sheet, height * height, np.float32(0))
    away = np.sqrt(np.maximum((weight * aside).sum(1), 0)) / spacing
    same_way = (weight * np.where(sheet, np.float32(1), facing)).sum(1)
    trust = smoothstep(2 - away) * smoothstep((same_way - 0.2) / 0.4)
    return Pull(step, outward, trust, (weight * front).sum(1), (weight * height).sum(1))


def smoothstep(x: Single) -> Single:
    """0 below 0, 1 above 1, smooth between."""
    t = np.clip(x, 0, 1)
    return np.asarray(t * t * (3 - 2 * t))
