"""Where the samples' surface passes over a point: a quadric fitted to the nearest of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mpf_core.cloud.neighbors import CHUNK, Neighborhoods, nearest

NEIGHBOURS = 16
BANDWIDTH = 0.6  # of the local spacing: halves the error of the signed local fit, keeps creases
RIDGE = 1e-5  # of the weights' sum: what few samples leave open is flat

Array = NDArray[np.float64]


def height_of_data(
    cloud: Neighborhoods, x: Array, normal: Array, oriented: Array, threads: int = -1
) -> Array:
    """(n,) how far along unit `normal` (n, 3) the surface of the samples lies from x (n, 3).

    Moving least squares with all terms of second order; `oriented` (m, 3) are the samples'
    normals, of which those steep to `normal` belong to another layer.
    """
    out = np.empty(len(x))
    for first in range(0, len(x), CHUNK):
        part = slice(first, first + CHUNK)
        out[part] = _heights(cloud, x[part], normal[part], oriented, threads)
    return out


def _heights(cloud: Neighborhoods, x: Array, normal: Array, oriented: Array, threads: int) -> Array:
    distance, index = nearest(cloud.tree, x, NEIGHBOURS, threads)
    spacing = np.maximum(cloud.spacing[index[:, :1]], 1e-12)
    offset = (cloud.points[index] - x[:, None]) / spacing[..., None]
    along = np.abs(np.einsum("nki,ni->nk", oriented[index], normal))
    ratio = (distance**2 - distance[:, :1] ** 2) / spacing**2
    weight = np.exp(-ratio / (2 * BANDWIDTH**2)) * (along > 0.5)
    least = np.eye(3)[np.abs(normal).argmin(1)]
    first = np.cross(normal, least)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    u, v, z = (
        np.einsum("nki,ni->nk", offset, axis) for axis in (first, np.cross(normal, first), normal)
    )
    terms = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=2)
    total = np.maximum(weight.sum(1), 1e-300)
    ridge = RIDGE * np.diag([0.0, 1, 1, 1, 1, 1]) + 1e-12 * np.eye(6)
    matrix = np.einsum("nk,nka,nkb->nab", weight, terms, terms) + total[:, None, None] * ridge
    right = np.einsum("nk,nka,nk->na", weight, terms, z)
    height: Array = np.linalg.solve(matrix, right[..., None])[:, 0, 0] * spacing[:, 0]
    return height
