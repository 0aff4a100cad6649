"""Neighbourhoods of the samples: KD-tree, spacing, PCA normals and how far they can be trusted.

All lengths are in the frame of the points given (normalised, when called by a fit).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

NEAREST = 50  # the farthest neighbour that the paper's near-surface sampling asks for
SPACING_NEIGHBOUR = 6  # distance to it ≈ 1.4 × the mean gap between samples of a surface
DISC_NEIGHBOUR = 18  # discs of this radius overlap into a sheet without leaks
LINKS = 9  # neighbours per point in the graph that orients the normals
CHUNK = 65_536  # points handled at once, so that memory stays a constant beside the cloud

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


def nearest(tree: cKDTree, x: Array, count: int, threads: int = -1) -> tuple[Array, Indices]:
    """Distances and indices (m, count) of the samples nearest to x (m, 3), in that order."""
    distance, index = tree.query(x, list(range(1, count + 1)), workers=threads)
    return np.asarray(distance), np.asarray(index, dtype=np.int64)


def distance_within(tree: cKDTree, x: Array, bound: float, threads: int = -1) -> Array:
    """(m,) distance to the nearest sample, infinity beyond `bound`: much faster than without."""
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

    @property
    def median_spacing(self) -> float:
        """Median distance to the 6th neighbour."""
        return float(np.median(self.spacing))

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
    out: dict[str, NDArray[Any]] = {
        "normals": np.empty((n, 3)),
        "tangents": np.empty((n, 3)),
        "rim": np.zeros((n, 3)),
        "spacing": np.empty(n),
        "disc_radius": np.empty(n),
        "band_radius": np.empty(n),
        "flatness": np.empty(n),
        "links": np.empty((n, LINKS), dtype=np.int32),
    }
    for start in range(0, n, CHUNK):
        part = slice(start, min(start + CHUNK, n))
        distance, index = nearest(tree, points[part], NEAREST + 1, threads)
        out["spacing"][part] = distance[:, SPACING_NEIGHBOUR]
        out["disc_radius"][part] = distance[:, DISC_NEIGHBOUR]
        out["band_radius"][part] = distance[:, NEAREST]
        out["links"][part] = index[:, 1 : LINKS + 1]
        k = normal_neighbours
        values, vectors = principal_axes(points[index[:, :k]], distance[:, :k])
        out["normals"][part] = vectors[:, :, 0]
        out["tangents"][part] = vectors[:, :, 2]
        out["flatness"][part] = np.sqrt(
            np.maximum(values[:, 0], 0) / np.maximum(values[:, 1], 1e-300)
        )
        out["rim"][part] = _rim_direction(points[part], points[index[:, 1:k]], vectors)
    return Neighborhoods(points=points, tree=tree, **out)


def principal_axes(patch: Array, distance: Array) -> tuple[Array, Array]:
    """Ascending eigenvalues and -vectors of weighted covariances of (m, k, 3) patches."""
    reach = 0.7 * distance[:, -1:]
    weight = np.exp(-((distance / np.maximum(reach, 1e-300)) ** 2))
    weight /= weight.sum(1, keepdims=True)
    offset = patch - np.einsum("mk,mki->mi", weight, patch)[:, None]
    values, vectors = np.linalg.eigh(np.einsum("mk,mki,mkj->mij", weight, offset, offset))
    return values, vectors


def _rim_direction(centres: Array, patch: Array, axes: Array) -> Array:
    """Unit direction into the widest angular gap between neighbours where it exceeds 2.2 rad."""
    first, second = axes[:, :, 2], axes[:, :, 1]
    offset = patch - centres[:, None]
    angle = np.arctan2(
        np.einsum("mki,mi->mk", offset, second), np.einsum("mki,mi->mk", offset, first)
    )
    angle.sort(axis=1)
    gap = np.diff(np.concatenate([angle, angle[:, :1] + 2 * np.pi], axis=1), axis=1)
    widest = gap.argmax(1)
    rows = np.arange(len(centres))
    middle = angle[rows, widest] + gap[rows, widest] / 2
    direction = np.cos(middle)[:, None] * first + np.sin(middle)[:, None] * second
    return np.where((gap[rows, widest] > 2.2)[:, None], direction, 0.0)
