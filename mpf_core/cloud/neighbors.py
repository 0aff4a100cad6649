"""Neighbourhoods of the samples: KD-tree, spacing, PCA normals and how far they can be trusted.

All lengths are in the frame of the points given (normalised, when called by a fit).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mpf_core.cloud.agreement import agreed
from mpf_core.cloud.angles import widest_gap
from mpf_core.cloud.features import sharpened
from mpf_core.cloud.layers import split
from mpf_core.cloud.rods import find_rods
from mpf_core.heeding import heed, in_parts

NEAREST = 50  # the farthest neighbour that the paper's near-surface sampling asks for
SPACING_NEIGHBOUR = 6  # distance to it ≈ 1.4 × the mean gap between samples of a surface
DISC_NEIGHBOUR = 18  # discs of this radius overlap into a sheet without leaks
LINKS = 9  # neighbours per point in the graph that orients the normals
CHUNK = 16_384  # points handled at once, so that memory stays a constant beside the cloud
OPEN_ANGLE = 2.2  # radians without neighbours from which a sample is at a rim
ROUND = 0.2  # flatness from which a patch may reach round a rod
TURNED = 0.7  # cosine below which a normal has turned away from the wall that it was told of
RESOLVED = 0.5  # local spacings: a thinner wall has too few samples on its rim to tell its plane
LAYERED_AROUND = 0.5  # share of a sample's links that must be layered as well for it to stay so

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Told = dict[str, NDArray[Any]]


def nearest(tree: cKDTree, x: Array, count: int, threads: int = -1) -> tuple[Array, Indices]:
    """Distances and indices (m, count) of the samples nearest to x (m, 3), in that order."""
    heed()
    distance, index = tree.query(x, list(range(1, count + 1)), workers=threads)
    return np.asarray(distance), np.asarray(index, dtype=np.int64)


def distance_within(tree: cKDTree, x: Array, bound: float, threads: int = -1) -> Array:
    """(m,) distance to the nearest sample, infinity beyond `bound`: much faster than without."""
    heed()
    distance, _ = tree.query(x, distance_upper_bound=bound, workers=threads)
    return np.asarray(distance)


@dataclass(frozen=True)
class Neighborhoods:
    """What the neighbours of each sample say about the surface there.

    points, normals, tangents: (n, 3); normals are unit and unoriented; `tangents` holds the
    direction of largest spread, so that (tangent, normal × tangent) spans the tangent plane.
    spacing, disc_radius, band_radius: (n,) distance to the 6th, 18th, 50th neighbour.
    links: (n, 9) indices of the nearest neighbours.
    rim: (n, 3) unit direction in the tangent plane in which the data ends, zero in the interior.
    flatness: (n,) spread along the normal divided by the spread in the tangent plane, in [0, 1].
    gap: (n,) distance to the other side of a wall or rod thinner than the patches, 0 where there is
    none. Where there is one, normals point away from the other side; for walls all but the band
    radius is told by the sample's own side alone. rods: (n,) whether it is a rod's.
    consistent: (n,) whether the normal fits the samples around, or is what these told; rim and
    tangents are from before that.
    """

    points: Array
    tree: cKDTree
    normals: Array
    tangents: Array
    spacing: Array
    disc_radius: Array
    band_radius: Array
    links: NDArray[np.int32]
    rim: Array
    flatness: Array
    gap: Array
    rods: NDArray[np.bool_]
    consistent: NDArray[np.bool_]

    @property
    def layered(self) -> NDArray[np.bool_]:
        """(n,) whether each sample is on one side of a thin wall."""
        return np.asarray(self.gap > 0)

    @property
    def median_spacing(self) -> float:
        """Median distance to the 6th neighbour."""
        return float(np.median(self.spacing))

    @property
    def areas(self) -> Array:
        """(n,) area of the surface that each sample stands for: a sixth of the disc out to its
        sixth neighbour."""
        return np.pi / SPACING_NEIGHBOUR * self.spacing**2

    @property
    def normal_reliability(self) -> float:
        """Share of samples whose normal agrees with its neighbours' within 30°, in [0, 1].

        Noise, sparsity and curvature below the spacing all lower it; on clean sheets it is
        above 0.95, on a cloud of pure noise near 0.3.
        """
        agreement = np.abs(np.einsum("nk,nlk->nl", self.normals, self.normals[self.links]))
        return float((np.median(agreement, axis=1) > np.cos(np.radians(30))).mean())


def median_spacing(tree: cKDTree, threads: int = -1, probes: int = 20_000) -> float:
    """Median distance to the 6th neighbour, from at most `probes` evenly picked points."""
    points = np.asarray(tree.data)
    picked = points[:: max(1, len(points) // probes)]
    return float(np.median(nearest(tree, picked, SPACING_NEIGHBOUR + 1, threads)[0][:, -1]))


def analyse(points: Array, *, normal_neighbours: int = 16, threads: int = -1) -> Neighborhoods:
    """Neighbourhoods of all `points` (n, 3), at least 51 of them."""
    tree = cKDTree(points)
    n = len(points)

    def look(part: slice) -> tuple[Told, Told]:
        distance, index = nearest(tree, points[part], NEAREST + 1, 1)
        return _looked(points, distance, index, normal_neighbours)

    parts = in_parts(look, n, threads)
    out, double = (_joined(told) for told in zip(*parts, strict=True))
    found = np.flatnonzero(out["gap"])
    # A few layered samples among others are an accident of their patches.
    sure = (out["gap"][out["links"][found]] > 0).mean(1) >= LAYERED_AROUND
    for name, values in double.items():
        out[name][found[sure]] = values[sure]
    out["gap"][found[~sure]] = 0.0
    rough = np.flatnonzero((out["flatness"] > ROUND) & (out["gap"] == 0))
    rods = find_rods(points, out["normals"], out["spacing"], out["links"], tree, rough, threads)
    out["normals"][rods.index], out["gap"][rods.index] = rods.normals, 2 * rods.radius
    out["rim"][rods.index] = 0.0
    out["rods"] = np.isin(np.arange(n), rods.index)
    out["normals"] = sharpened(
        points, out["normals"], out["spacing"], out["flatness"], tree,
        fixed=out["gap"] > 0, threads=threads,
    )  # fmt: skip
    out |= _agreed(points, out, rods.index, tree, threads)
    return Neighborhoods(points=points, tree=tree, **out)


def _agreed(
    points: Array,
    told: Told,
    rods: Indices,
    tree: cKDTree,
    threads: int,
) -> Told:
    """Normals and gaps once samples whose normals do not fit have asked those around."""
    gap = told["gap"][told["links"]]
    # Of the rim of a wall thinner than the samples show, those around know nothing.
    thinner = (gap > 0) & (gap < RESOLVED * told["spacing"][:, None])
    fixed: NDArray[np.bool_] = np.asarray(thinner.any(1))
    fixed[rods] = True
    found = agreed(points, told["normals"], told["links"], tree, fixed=fixed, threads=threads)
    cosine = np.einsum("nk,nk->n", told["normals"], found.normals)
    return {
        "normals": np.where(cosine < 0, -1.0, 1.0)[:, None] * found.normals,
        # What turns away from the other side of a wall is at its end, not on a side of it.
        "gap": np.where(np.abs(cosine) < TURNED, 0.0, told["gap"]),
        "consistent": found.sure,
    }


def _joined(told: Sequence[Told]) -> Told:
    return {name: np.concatenate([some[name] for some in told]) for name in told[0]}


def _looked(points: Array, distance: Array, index: Indices, size: int) -> tuple[Told, Told]:
    """What the neighbours (m, NEAREST + 1), the sample itself first, say of m samples; and for
    those among them with a `gap`, what those of their own layer say."""
    told = _described(points, distance, index, size)
    layers = split(points[index])
    told["band_radius"] = distance[:, NEAREST]
    told["gap"] = np.where(layers.layered, layers.gap, 0.0)
    rows = np.flatnonzero(told["gap"])
    # The sample's own layer first, each in order of distance.
    own = layers.own[rows]
    order = np.argsort(~own, axis=1, kind="stable")
    by_own = _described(
        points,
        np.take_along_axis(distance[rows], order, axis=1),
        np.take_along_axis(index[rows], order, axis=1),
        size,
        own.sum(1),
    )
    turned = np.einsum("ni,ni->n", by_own["normals"], layers.away[rows]) < 0
    by_own["normals"][turned] *= -1
    return told, by_own


def _described(
    points: Array,
    distance: Array,
    index: Indices,
    size: int,
    count: NDArray[np.int64] | None = None,
) -> Told:
    """What the neighbours (m, NEAREST + 1), the sample itself first, say; only the first `count`
    (m,) of each row are looked at."""
    m = len(index)
    most = np.full(m, NEAREST + 1) if count is None else count
    used = np.arange(size) < most[:, None]
    patch = points[index[:, :size]]
    values, vectors = principal_axes(patch, distance[:, :size], used)
    rows = np.arange(m)
    disc = np.minimum(DISC_NEIGHBOUR, most - 1)
    links = index[:, 1 : LINKS + 1]
    linked = np.arange(1, LINKS + 1) < most[:, None]
    return {
        "normals": vectors[:, :, 0].copy(),
        "tangents": vectors[:, :, 2].copy(),
        "flatness": np.sqrt(np.maximum(values[:, 0], 0) / np.maximum(values[:, 1], 1e-300)),
        "rim": _rim_direction(points, index, most, vectors, size),
        "spacing": distance[rows, np.minimum(SPACING_NEIGHBOUR, most - 1)],
        # Fewer neighbours cover less: the radius grows as the root of their number.
        "disc_radius": distance[rows, disc] * np.sqrt(DISC_NEIGHBOUR / np.maximum(disc, 1)),
        # A sample without enough neighbours is linked to itself instead.
        "links": np.where(linked, links, index[:, :1]).astype(np.int32),
    }


def principal_axes(
    patch: Array, distance: Array, used: NDArray[np.bool_] | None = None
) -> tuple[Array, Array]:
    """Ascending eigenvalues and -vectors of weighted covariances of (m, k, 3) patches, of the
    members `used` (m, k) if given."""
    farthest = distance[:, -1:] if used is None else (distance * used).max(1, keepdims=True)
    weight = np.exp(-((distance / np.maximum(0.7 * farthest, 1e-300)) ** 2))
    if used is not None:
        weight *= used
    weight /= weight.sum(1, keepdims=True)
    offset = patch - weight[:, None] @ patch
    values, vectors = np.linalg.eigh((weight[..., None] * offset).swapaxes(1, 2) @ offset)
    return values, vectors


def _rim_direction(
    points: Array, index: Indices, most: NDArray[np.int64], axes: Array, size: int
) -> Array:
    """Unit direction (m, 3) into the widest angular gap between the first `size` neighbours where
    it exceeds OPEN_ANGLE, and so does that between all: of 15 random directions one in thirty has
    such a gap, of 50 hardly any."""
    middle, widest = _widest_gap(points, index[:, :size], most, axes)
    open_rows = np.flatnonzero(widest > OPEN_ANGLE)
    rim = np.zeros((len(index), 3))
    _, wider = _widest_gap(points, index[open_rows], most[open_rows], axes[open_rows])
    rows = open_rows[wider > OPEN_ANGLE]
    angle, first, second = middle[rows, None], axes[rows, :, 2], axes[rows, :, 1]
    rim[rows] = np.cos(angle) * first + np.sin(angle) * second
    return rim


def _widest_gap(
    points: Array, index: Indices, most: NDArray[np.int64], axes: Array
) -> tuple[Array, Array]:
    """Middle and width (m,) of the widest angle without neighbours, in the tangent plane."""
    offset = points[index[:, 1:]] - points[index[:, :1]]
    first, second = axes[:, :, 2], axes[:, :, 1]
    angle = np.arctan2(
        np.einsum("mki,mi->mk", offset, second), np.einsum("mki,mi->mk", offset, first)
    )
    used = np.arange(1, index.shape[1]) < most[:, None]
    return widest_gap(np.where(used, angle, angle[:, :1]))  # the nearest is used whenever any is
