"""Normals at sharp edges: where the patch of a sample spans two faces, PCA gives their mean.

The sample lies on one of the faces, and some of its neighbours lie well inside of it: among their
normals is the one whose plane through the sample holds the most of the patch. Where that plane
explains clearly more than the patch's own, it takes its place (a consensus as in Fleishman et al.
2005, with the neighbours' normals as the only candidates, so that nothing is drawn at random).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

PATCH = 24  # neighbours that vote
CANDIDATES = 8  # of them, evenly over the patch, whose normals are tried
ROUNDS = 2  # the second lets normals corrected by the first reach the samples beside the edge
BENT = 0.06  # flatness (spread across / along) from which a patch may span an edge
CLOSE = 0.07  # of the local spacing: within it a neighbour is on the plane
GAIN = 2.0  # times the votes of the patch's own plane
CHUNK = 8192

Array = NDArray[np.float64]


def sharpened(
    points: Array,
    normals: Array,
    spacing: Array,
    flatness: Array,
    tree: cKDTree,
    *,
    fixed: NDArray[np.bool_],
    threads: int = -1,
) -> Array:
    """Unit normals (n, 3), those beside sharp edges replaced by their own face's.

    points, normals: (n, 3); spacing, flatness: (n,); fixed: (n,) those to leave alone.
    """
    rows = np.flatnonzero((flatness > BENT) & ~fixed)
    normals = normals.copy()
    if len(rows) == 0 or len(points) <= PATCH:
        return normals
    index = np.empty((len(rows), PATCH), dtype=np.int64)
    for k in range(0, len(rows), CHUNK):
        found = tree.query(points[rows[k : k + CHUNK]], PATCH + 1, workers=threads)[1]
        index[k : k + CHUNK] = np.asarray(found)[:, 1:]
    for _ in range(ROUNDS):
        # All from the normals before the round, so that the order of samples does not matter.
        before = normals.copy()
        for k in range(0, len(rows), CHUNK):
            part = slice(k, k + CHUNK)
            width = CLOSE * spacing[rows[part]]
            normals[rows[part]] = _voted(points, before, rows[part], index[part], width)
    return normals


def _voted(
    points: Array,
    normals: Array,
    rows: NDArray[np.int64],
    index: NDArray[np.int64],
    width: Array,
) -> Array:
    offset = (points[index] - points[rows, None]) / width[:, None, None]  # (m, k, 3)
    step = PATCH // CANDIDATES
    candidates = np.concatenate([normals[rows, None], normals[index[:, ::step]]], axis=1)
    height = candidates.astype(np.float32) @ offset.astype(np.float32).transpose(0, 2, 1)
    votes = np.exp(-0.5 * height**2)  # (m, c, k)
    total = votes.sum(2)
    best = total.argmax(1)
    better = total[np.arange(len(rows)), best] > GAIN * total[:, 0]
    chosen = normals[rows].copy()
    take = np.flatnonzero(better)
    if len(take):
        chosen[take] = _refitted(
            offset[take], votes[take, best[take]], candidates[take, best[take]]
        )
    return chosen


def _refitted(offset: Array, weight: Array, normal: Array) -> Array:
    """The plane through the origin that fits the voters best, on the side of `normal`."""
    scatter = np.einsum("mk,mki,mkj->mij", weight, offset, offset)
    fitted = np.linalg.eigh(scatter)[1][:, :, 0]
    turned = np.einsum("mi,mi->m", fitted, normal)
    return np.asarray(fitted * np.where(turned < 0, -1.0, 1.0)[:, None])
