"""The data as oriented planes that pull vertices: robust implicit moving least squares.

A sample pᵢ with its outward normal nᵢ is a plane. A vertex x with outward direction g is pulled by
the planes that face the same way, weighted by wᵢ ∝ exp(−|x − pᵢ|²/2h² − |nᵢ − g|²/σ²) (the normals'
part after Öztireli et al. 2009): across an edge, or through a thin wall, samples of the other side
have no say. A sample of an open sheet is two planes, its own and one that faces back a thickness t
behind it, so that each wall of the shell around a sheet has its own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mpf_core.cloud.neighbors import Neighborhoods, nearest
from mpf_core.surface.normals import unit_normals

NEIGHBOURS = 16  # half of them may belong to the other side of a thin wall
BANDWIDTH = 0.45  # h over the local spacing on clean data, as in the fit's own local surface
BANDWIDTHS = (0.45, 0.65, 0.9, 1.25, 1.7)  # tried; h beyond needs more than WIDE neighbours
WIDE = 64
FACING = 0.5  # σ: a plane turned by 40° has a seventh of the weight, by 90° a three-thousandth
PROBES = 6000  # samples at which bandwidths are judged
SHARPENINGS = 3  # rounds of the filter that takes the rounding of normals near edges back
CHUNK = 16_384

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True)
class Planes:
    """points, normals: (n, 3), oriented; spacing: (n,) local; sheet: (n,) whether the sample is of
    an open sheet; thickness: t of the shell around those; deviation: standard error of the points
    across the surface, from what their neighbours predict; bandwidth: h over the spacing that
    predicts best."""

    points: Array
    tree: cKDTree
    normals: Array
    spacing: Array
    sheet: NDArray[np.bool_]
    thickness: float
    deviation: float
    bandwidth: float


@dataclass(frozen=True)
class Pull:
    """What the planes want of m vertices.

    step: (m, 3) to the surface; outward: (m, 3) normal there, not of unit length where planes
    disagree; trust: (m,) in [0, 1], 0 far from data or where none faces the vertex's way;
    front: (m,) share of planes that are samples' own; offset: (m,) signed height over the samples.
    """

    step: Array
    outward: Array
    trust: Array
    front: Array
    offset: Array


def planes_of(
    cloud: Neighborhoods,
    normals: Array,
    sheet: NDArray[np.bool_],
    thickness: float,
    threads: int = -1,
) -> Planes:
    """The planes of a cloud with oriented `normals` (n, 3), freed of noise as far as leave-one-out
    prediction says that a wider kernel helps."""
    bandwidth, deviation = best_bandwidth(cloud, normals, threads)
    made = Planes(
        cloud.points, cloud.tree, normals, cloud.spacing, sheet, thickness, deviation, bandwidth
    )
    if bandwidth > BANDWIDTH:
        points, normals = _smoothed(made, threads)
        made = replace(made, points=points, normals=normals, tree=cKDTree(points))
    return replace(made, normals=_sharpened(made, threads))


def best_bandwidth(cloud: Neighborhoods, normals: Array, threads: int = -1) -> tuple[float, float]:
    """Bandwidth (over the spacing) at which the others predict a sample's height best, and the
    standard error of the surface fitted with it."""
    n = len(cloud.points)
    probe = np.unique(np.linspace(0, n - 1, min(n, PROBES)).astype(np.int64))
    count = min(WIDE, n - 1)
    distance, index = nearest(cloud.tree, cloud.points[probe], count + 1, threads)
    distance, index = distance[:, 1:], index[:, 1:]
    offset = cloud.points[probe][:, None] - cloud.points[index]
    facing = normals[index]
    same = np.einsum("mki,mi->mk", facing, normals[probe]) > 0.5
    residual, share = [], []
    for bandwidth in BANDWIDTHS:
        h = bandwidth * cloud.spacing[probe][:, None]
        weight = (np.exp(-(distance**2) / (2 * h**2)) + 1e-30) * (same + 1e-6)
        total = weight.sum(1)
        weight /= total[:, None]
        mean = unit_normals(np.einsum("mk,mki->mi", weight, facing))
        plane = 0.5 * (facing + mean[:, None])
        residual.append(np.einsum("mk,mki,mki->m", weight, plane, offset))
        # With the sample itself back in, at weight 1: Σ w² of the fit that is used.
        share.append(np.median(((weight * total[:, None]) ** 2).sum(1) + 1) / (1 + total) ** 2)
    error = np.abs(residual)
    # Edges and rims, which no bandwidth predicts, must not decide.
    usual = error.mean(0) <= np.quantile(error.mean(0), 0.9)
    mean_square = (error[:, usual] ** 2).mean(1)
    best = int(np.flatnonzero(mean_square <= 1.02 * mean_square.min())[0])
    shared = float(np.median(share[best]))
    return BANDWIDTHS[best], float(np.sqrt(mean_square[best] * shared / (1 + shared)))


def _smoothed(planes: Planes, threads: int) -> tuple[Array, Array]:
    """Points on the surface fitted with the wide kernel, and the normals there."""
    points, normals = np.empty_like(planes.points), np.empty_like(planes.points)

    def work(part: slice) -> None:
        x = planes.points[part]
        distance, index = nearest(planes.tree, x, min(WIDE, len(planes.points)), 1)
        h = planes.bandwidth * planes.spacing[part][:, None]
        facing = planes.normals[index]
        same = np.einsum("mki,mi->mk", facing, planes.normals[part]) > 0.5
        weight = np.exp(-(distance**2) / (2 * h**2)) * same
        weight /= weight.sum(1, keepdims=True)
        mean = unit_normals(np.einsum("mk,mki->mi", weight, facing))
        plane = 0.5 * (facing + mean[:, None])
        height = np.einsum("mk,mki,mki->m", weight, plane, x[:, None] - planes.points[index])
        points[part], normals[part] = x - height[:, None] * mean, mean

    in_parts(work, len(points), threads)
    return points, normals


def _sharpened(planes: Planes, threads: int) -> Array:
    """Normals drawn to those of neighbours that face alike: corners become corners again."""
    normals = planes.normals
    index = nearest(planes.tree, planes.points, min(NEIGHBOURS, len(normals)), threads)[1]
    offset = planes.points[index] - planes.points[:, None]
    apart = np.einsum("nki,nki->nk", offset, offset) / (2 * (0.7 * planes.spacing[:, None]) ** 2)
    for _ in range(SHARPENINGS):
        facing = normals[index]
        turned = 1 - np.einsum("nki,ni->nk", facing, normals)
        weight = np.exp(-apart - 2 * turned / FACING**2)
        normals = unit_normals(np.einsum("nk,nki->ni", weight, facing))
    return normals


def pull(planes: Planes, x: Array, direction: Array, index: Indices) -> Pull:
    """The pull of the planes `index` (m, k) on x (m, 3) with unit outward `direction` (m, 3)."""
    normals, sheet = planes.normals[index], planes.sheet[index]
    offset = x[:, None] - planes.points[index]
    facing = np.einsum("mki,mi->mk", normals, direction)
    spacing = planes.spacing[index[:, 0]]
    square = np.einsum("mki,mki->mk", offset, offset)
    agree = np.where(sheet, np.abs(facing), facing)
    log_weight = -square / (2 * (BANDWIDTH * spacing[:, None]) ** 2) - 2 * (1 - agree) / FACING**2
    weight = np.exp(log_weight - log_weight.max(1, keepdims=True))
    weight /= weight.sum(1, keepdims=True)
    front = np.where(sheet, smoothstep(0.5 * (1 + facing / 0.7)), 1.0)
    mean = np.einsum("mk,mki->mi", weight, normals)
    length = np.einsum("mi,mi->m", mean, mean)
    unit = mean / np.sqrt(np.maximum(length, 1e-12))[:, None]
    height = np.einsum("mki,mki->mk", 0.5 * (normals + unit[:, None]), offset)
    wanted = weight * (height + (1 - front) * planes.thickness)
    # Divided by |Σ w n|², one step leads to an edge between planes as it does to a single plane.
    step = -np.einsum("mk,mki->mi", wanted, normals) / np.maximum(length, 0.3)[:, None]
    outward = np.einsum("mk,mki->mi", weight * (2 * front - 1), normals)
    away = np.sqrt((weight * square).sum(1)) / spacing
    same_way = (weight * np.where(sheet, 1.0, facing)).sum(1)
    trust = smoothstep((2.4 - away) / 1.2) * smoothstep((same_way - 0.2) / 0.4)
    return Pull(step, outward, trust, (weight * front).sum(1), (weight * height).sum(1))


def smoothstep(x: Array) -> Array:
    """0 below 0, 1 above 1, smooth between."""
    t = np.clip(x, 0.0, 1.0)
    return np.asarray(t * t * (3 - 2 * t))


def in_parts(work: Callable[[slice], None], count: int, threads: int) -> None:
    """Run `work` on slices that cover `count` rows, on threads: NumPy lets go of the lock."""
    with ThreadPoolExecutor(max_workers=threads if threads > 0 else None) as pool:
        list(pool.map(work, _parts(count)))


def _parts(count: int) -> Iterator[slice]:
    for start in range(0, count, CHUNK):
        yield slice(start, min(start + CHUNK, count))
