"""The data as small quadric patches that pull vertices: moving least squares, one wall at a time.

Each sample pᵢ has a patch hᵢ(x) = nᵢ·(x − pᵢ) − ½ (x − pᵢ)ᵀKᵢ(x − pᵢ), fitted to the samples around
it that face its way. A vertex x with outward direction g is pulled by the patches near it, weighted
by wᵢ ∝ exp(−|x − pᵢ|²/2h² − |nᵢ − g|²/σ²) (the normals' part after Öztireli et al. 2009): across an
edge, or through a thin wall, patches of the other side have no say. A sample of an open sheet has
two patches, its own and one that faces back a thickness t behind it, so that each wall of the shell
around a sheet has its own.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mpf_core.cloud.neighbors import Neighborhoods, nearest
from mpf_core.surface.normals import unit_normals

NEIGHBOURS = 16  # patches that may pull a vertex; half of them can be the other side of a wall
BLEND = 0.45  # h over the local spacing
FACING = 0.35  # σ: a patch turned by 20° has a third of the weight, by 40° a fiftieth
# Kernels tried, over the spacing, with neighbours that reach far enough for each: six unknowns need
# the first on clean data, noise may ask for more.
KERNELS = ((0.8, 24), (1.2, 50), (1.8, 110))
ROUNDS = 3  # of fitting: each turns the normals, which says anew who faces the same way
RIDGE = 1e-3  # on curvatures, of the weight: decides only where there are too few samples
NEGLIGIBLE = 2e-3  # of the spacing: errors below need no wider kernel
PROBES = 3000  # samples at which kernels are judged
CHUNK = 8192

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

    The kernel is the one with which neighbours predict left-out samples best; beyond the narrowest,
    samples move onto their patches, since then they scatter about the surface.
    """
    (kernel, count), deviation = _best_kernel(cloud, normals, threads)
    fitted, curvature, height = _fitted(
        cloud, normals, slice(None), kernel, count, ROUNDS, threads
    )[:3]
    points, tree = cloud.points, cloud.tree
    if kernel > KERNELS[0][0]:
        points = points + height[:, None] * fitted
        tree = cKDTree(points)
    single = (a.astype(np.float32) for a in (points, fitted, curvature, cloud.spacing))
    p, n, k, s = single
    return Patches(p, tree, n, k, s, sheet, thickness, kernel, deviation)


def _best_kernel(
    cloud: Neighborhoods, normals: Array, threads: int
) -> tuple[tuple[float, int], float]:
    """The kernel with the least error of leave-one-out, and the standard error it leaves.

    A sample's height over the fit without it is its residual divided by 1 − H, H its own leverage.
    """
    n = len(cloud.points)
    probe = np.unique(np.linspace(0, n - 1, min(n, PROBES)).astype(np.int64))
    tried = [kernel for kernel in KERNELS if kernel[1] <= n // 4] or [KERNELS[0]]
    error, leverage = [], []
    for kernel, count in tried:
        _, _, height, own = _fitted(cloud, normals, probe, kernel, count, 1, threads)
        error.append(np.abs(height) / np.maximum(1 - own, 0.05))
        leverage.append(float(np.median(own)))
    # Edges and rims, which no kernel predicts, must not decide: medians, not means.
    spread = 1.48 * np.median(error, axis=1)
    enough = NEGLIGIBLE * float(np.median(cloud.spacing[probe]))
    best = int(np.flatnonzero(spread <= max(1.02 * spread.min(), enough))[0])
    share = leverage[best] * (1 - leverage[best])
    return tried[best], float(spread[best] * np.sqrt(share))


def _fitted(
    cloud: Neighborhoods,
    normals: Array,
    rows: slice | Indices,
    kernel: float,
    count: int,
    rounds: int,
    threads: int,
) -> tuple[Array, Array, Array, Array]:
    """Normals (m, 3), curvatures (m, 3, 3), heights of the fit over the samples (m,) and the
    samples' leverage (m,) at `rows` of the cloud."""
    place = np.arange(len(cloud.points))[rows]
    size = len(place)
    turned, curvature = normals[place].copy(), np.empty((size, 3, 3))
    height, leverage = np.empty(size), np.empty(size)
    everyone = normals.copy()
    count = min(count, len(cloud.points))
    for _ in range(rounds):

        def work(part: slice) -> None:
            index = nearest(cloud.tree, cloud.points[place[part]], count, 1)[1]
            offset = cloud.points[index] - cloud.points[place[part]][:, None]
            scale = cloud.spacing[place[part]]
            fit = _quadric(offset, everyone[index], turned[part], scale, kernel)
            turned[part], curvature[part], height[part], leverage[part] = fit

        in_parts(work, size, threads)
        everyone[place] = turned
    return turned, curvature, height, leverage


def _quadric(
    offset: Array, facing: Array, normal: Array, scale: Array, kernel: float
) -> tuple[Array, Array, Array, Array]:
    """Least-squares quadrics z(u, v) over tangent planes, from (m, k, 3) offsets of neighbours."""
    first = unit_normals(np.cross(normal, np.eye(3)[np.abs(normal).argmin(1)]))
    second = np.cross(normal, first)
    frame = np.stack([first, second, normal], axis=2) / scale[:, None, None]
    u, v, z = np.moveaxis(offset @ frame, 2, 0)
    turned = 1 - np.einsum("mki,mi->mk", facing, normal)
    weight = np.exp(-(u**2 + v**2 + z**2) / (2 * kernel**2) - 2 * turned / FACING**2)
    basis = np.stack([np.ones_like(u), u, v, 0.5 * u * u, u * v, 0.5 * v * v], axis=2)
    weighted = basis * weight[:, :, None]
    matrix = weighted.transpose(0, 2, 1) @ basis
    ridge = RIDGE * matrix[:, 0, 0]
    for i, share in enumerate((1e-6, 1e-3, 1e-3, 1.0, 1.0, 1.0)):
        matrix[:, i, i] += share * ridge
    right = np.stack([(weighted * z[:, :, None]).sum(1), np.tile(np.eye(6)[0], (len(u), 1))], 2)
    solved = np.linalg.solve(matrix, right)
    c = solved[:, :, 0]
    a, b = first[:, :, None], second[:, :, None]
    shape = c[:, 3, None, None] * (a * a.transpose(0, 2, 1))
    shape += c[:, 4, None, None] * (a * b.transpose(0, 2, 1) + b * a.transpose(0, 2, 1))
    shape += c[:, 5, None, None] * (b * b.transpose(0, 2, 1))
    slope = c[:, 1:2] * first + c[:, 2:3] * second
    return (
        unit_normals(normal - slope),
        shape / scale[:, None, None],
        c[:, 0] * scale,
        np.clip(solved[:, 0, 1], 0, 1),  # the sample itself has weight 1 and basis (1, 0, …)
    )


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


def in_parts(work: Callable[[slice], None], count: int, threads: int) -> None:
    """Run `work` on slices that cover `count` rows, on threads: NumPy lets go of the lock."""
    parts = [slice(start, min(start + CHUNK, count)) for start in range(0, count, CHUNK)]
    with ThreadPoolExecutor(max_workers=threads if threads > 0 else None) as pool:
        list(pool.map(work, parts))
