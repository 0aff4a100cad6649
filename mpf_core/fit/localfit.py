"""A classical signed fit to the samples: implicit moving least squares with oriented normals.

f(x) = Σ wᵢ ½(nᵢ + n̄)·(x − pᵢ) with Gaussian weights, n̄ the weighted mean normal: second-order
exact on smooth surfaces (symmetrised normals, after Öztireli et al. 2009 and Levin 2003). It is the
start that the field is regressed to, never its end: the weights of the regression go to zero.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mpf_core.cloud.neighbors import Neighborhoods, nearest

NEIGHBOURS = 8
BANDWIDTH = 0.45  # of the local spacing; smaller follows noise, larger rounds edges

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LocalDistance:
    """The local fit at n points, normalised units.

    signed: (n,) f(x); normal: (n, 3) unit n̄; beyond: (n,) distance beyond the rim of the data
    along the surface, 0 over the data; nearest: (n,) distance to the nearest sample;
    spacing: (n,) local spacing there.
    """

    signed: Array
    normal: Array
    beyond: Array
    nearest: Array
    spacing: Array


@dataclass(frozen=True)
class LocalFit:
    """The local fit over one cloud; `normals` (n, 3) are oriented."""

    neighbours: Neighborhoods
    normals: Array
    threads: int = -1

    def at(self, x: Array) -> LocalDistance:
        """Evaluate at x (m, 3)."""
        cloud = self.neighbours
        distance, index = nearest(cloud.tree, x, NEIGHBOURS, self.threads)
        normals = self.normals[index]  # (m, k, 3)
        spacing = np.maximum(cloud.spacing[index[:, 0]], 1e-12)
        along = np.einsum("mki,mi->mk", normals, normals[:, 0])
        # Samples whose plane is steep to the nearest one's belong to another face or layer.
        weight = np.exp(
            -(distance**2 - distance[:, :1] ** 2) / (2 * (BANDWIDTH * spacing[:, None]) ** 2)
        ) * (np.abs(along) > 0.5)
        weight /= weight.sum(1, keepdims=True)
        facing = normals * np.where(along < 0, -1.0, 1.0)[..., None]
        mean = np.einsum("mk,mki->mi", weight, facing)
        mean /= np.linalg.norm(mean, axis=1, keepdims=True) + 1e-12
        offset = x[:, None] - cloud.points[index]  # (m, k, 3)
        symmetric = 0.5 * (facing + mean[:, None])
        signed = np.einsum("mk,mki,mki->m", weight, symmetric, offset)
        beyond = self._beyond_rim(x, index, offset, mean, spacing)
        return LocalDistance(signed, mean, beyond, distance[:, 0], spacing)

    def _beyond_rim(
        self, x: Array, index: NDArray[np.int64], offset: Array, mean: Array, spacing: Array
    ) -> Array:
        cloud = self.neighbours
        height = np.einsum("mki,mi->mk", offset, mean)
        lateral = np.sqrt(np.maximum((offset**2).sum(-1) - height**2, 0)).min(1)
        beyond = np.maximum(lateral - 0.9 * spacing, 0)
        first = index[:, 0]
        rim = cloud.rim[first]
        outward = np.einsum("mi,mi->m", x - cloud.points[first], rim) - 0.15 * spacing
        past: Array = np.where(rim.any(1), np.maximum(beyond, outward), beyond)
        return past
