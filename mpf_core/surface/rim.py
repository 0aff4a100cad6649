"""Where the data ends: the rim of an open surface, from its samples alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mpf_core.cloud.neighbors import Neighborhoods, nearest

SHARED = 8  # rim samples that say together where the data ends
ALONG = 0.3  # cosine between directions of rim samples on one side of a narrow tip
INWARDS = -3.0  # what is told far from any rim, in spacings

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Rim:
    """Samples at the end of the data: `points`, unit `outward` directions (m, 3), `spacing` (m,);
    `tree` over the points, None where the data has no end."""

    points: Array
    outward: Array
    spacing: Array
    tree: cKDTree | None

    @classmethod
    def of(cls, cloud: Neighborhoods) -> Rim:
        """The rim of a cloud."""
        chosen = np.flatnonzero(cloud.rim.any(1))
        points = cloud.points[chosen]
        tree = cKDTree(points) if len(points) else None
        return cls(points, cloud.rim[chosen], cloud.spacing[chosen], tree)

    def beyond(self, x: Array, threads: int = -1) -> Array:
        """(n,) how far x (n, 3) lies beyond the rim along the surface, in local spacings.

        The mean over the rim samples nearby, which lie now at the edge and now a little inside:
        about 0 half way between them.
        """
        if self.tree is None:
            return np.full(len(x), INWARDS)
        count = min(SHARED, len(self.points))
        distance, index = nearest(self.tree, x, count, threads)
        spacing = self.spacing[index[:, :1]]
        along = np.einsum("nki,ni->nk", self.outward[index], self.outward[index[:, 0]])
        weight = np.exp(-0.5 * (distance**2 - distance[:, :1] ** 2) / spacing**2) * (along > ALONG)
        past = np.einsum("nki,nki->nk", x[:, None] - self.points[index], self.outward[index])
        mean = (weight * past).sum(1) / weight.sum(1) / spacing[:, 0]
        return np.where(
            distance[:, 0] > -INWARDS * spacing[:, 0], INWARDS, np.maximum(mean, INWARDS)
        )
