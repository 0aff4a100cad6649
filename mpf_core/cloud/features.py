"""Normals at sharp edges: where the patch of a sample spans two faces, PCA gives their mean.

The sample lies on one of the faces, and some of its neighbours lie well inside of it: among their
normals is the one whose plane through the sample holds the most of the patch. Where that plane
explains clearly more than the patch's own, it takes its place (a consensus as in Fleishman et al.
2005; nothing is drawn at random).

Where a face is only a few spacings wide, as the rim of a plate, no sample on it has a patch of one
face. So the planes through the sample and two of its nearest neighbours are candidates too, if the
whole patch lies on one side: a face at an edge is such a plane, a chord of a rounded rod is not.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mpf_core.heeding import ROWS_AT_ONCE, on_threads


class Face(NamedTuple):
    """What makes a plane a face: the share of the patch that it holds, and how many times the
    votes of the patch's own plane it must have."""

    share: float
    gain: float


PATCH = 24  # neighbours that vote
CANDIDATES = 8  # of them, evenly over the patch, whose normals are tried
NEAREST = 8  # of them, whose pairs make planes with the sample
OFF = 3.0  # widths of a plane from which a neighbour is beside it
ACROSS = 1  # neighbour on the wrong side of such a plane, at most
ROUNDS = 2  # the second lets normals corrected by the first reach the samples beside the edge
BENT = 0.06  # flatness (spread across / along) from which a patch may span an edge
BROKEN = 0.2  # and from which no patch around may be of one face
CLOSE = 0.07  # of the local spacing: within it a neighbour is on the plane
GAIN = 2.0  # times the votes of the patch's own plane
# A plane that holds this share of the patch, and from which most of the rest falls steeply away, by
# so many widths, is a face for sure and needs to be less better.
FACE = Face(0.28, 1.4)
# In a cloud without noise, a quarter of whose patches are flatter than CLEAN, less will do.
CLEAN, CLEAN_FACE = 0.04, Face(0.18, 1.15)
STEEP = 7.0

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
    normals = normals.copy()
    asked = np.flatnonzero((flatness > BENT) & ~fixed)
    if len(asked) == 0 or len(points) <= PATCH:
        return normals
    face = CLEAN_FACE if np.quantile(flatness, 0.25) < CLEAN else FACE
    broken = flatness[asked] > BROKEN  # the others need no planes through pairs
    parts = [
        (rows[k : k + ROWS_AT_ONCE], pairs)
        for rows, pairs in ((asked[~broken], False), (asked[broken], True))
        for k in range(0, len(rows), ROWS_AT_ONCE)
    ]
    around = [
        np.asarray(tree.query(points[rows], PATCH + 1, workers=threads)[1])[:, 1:]
        for rows, _ in parts
    ]

    def vote(part: int, before: Array) -> None:
        (rows, pairs), index = parts[part], around[part]
        width = CLOSE * spacing[rows]
        normals[rows] = _voted(points, before, rows, index, width, face, pairs=pairs)

    for _ in range(ROUNDS):
        # All from the normals before the round, so that the order of samples does not matter.
        on_threads(partial(vote, before=normals.copy()), range(len(parts)), threads)
    return normals


def _voted(
    points: Array,
    normals: Array,
    rows: NDArray[np.int64],
    index: NDArray[np.int64],
    width: Array,
    face: Face,
    *,
    pairs: bool,
) -> Array:
    offset = (points[index] - points[rows, None]) / width[:, None, None]  # (m, k, 3)
    step = PATCH // CANDIDATES
    candidates = np.concatenate([normals[rows, None], normals[index[:, ::step]]], axis=1)
    votes, total = _votes(candidates, offset)
    if pairs:
        through = _through_pairs(offset[:, :NEAREST])
        more_votes, more = _votes(through, offset, one_sided=face.share)
        candidates = np.concatenate([candidates, through], axis=1)
        votes, total = (np.concatenate(p, axis=1) for p in ((votes, more_votes), (total, more)))
    best = total.argmax(1)
    each = np.arange(len(rows))
    most, chosen = total[each, best], candidates[each, best]
    height = np.abs((offset @ chosen[..., None])[..., 0])
    steep = (height > OFF).sum(1) < 1.5 * (height > STEEP).sum(1)
    gain = np.where(steep & (most > face.share * PATCH), face.gain, GAIN)
    better = most > gain * total[:, 0]
    found = normals[rows].copy()
    take = np.flatnonzero(better)
    if len(take):
        found[take] = _refitted(offset[take], votes[take, best[take]], chosen[take])
    return found


def _votes(
    candidates: Array, offset: Array, *, one_sided: float | None = None
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """How much each neighbour (m, k) lies on each candidate plane (m, c), and their sums, 0 where
    they are less than that share or neighbours lie on both sides, if `one_sided` is given."""
    height = candidates.astype(np.float32) @ offset.astype(np.float32).transpose(0, 2, 1)
    votes: NDArray[np.float32] = np.exp(-0.5 * height**2)  # (m, c, k)
    total: NDArray[np.float32] = votes.sum(2)
    if one_sided is not None:
        fewer = np.minimum((height > OFF).sum(2), (height < -OFF).sum(2))
        total[(fewer > ACROSS) | (total < one_sided * PATCH)] = 0
    return votes, total


def _through_pairs(offset: Array) -> Array:
    """(m, c, 3) unit normals of planes through the origin and each pair of `offset` (m, k, 3)."""
    first, second = np.triu_indices(offset.shape[1], 1)
    normal = np.cross(offset[:, first], offset[:, second])
    return np.asarray(normal / (np.linalg.norm(normal, axis=2, keepdims=True) + 1e-12))


def _refitted(offset: Array, weight: Array, normal: Array) -> Array:
    """The plane through the origin that fits the voters best, on the side of `normal`."""
    scatter = np.einsum("mk,mki,mkj->mij", weight, offset, offset)
    fitted = np.linalg.eigh(scatter)[1][:, :, 0]
    turned = np.einsum("mi,mi->m", fitted, normal)
    return np.asarray(fitted * np.where(turned < 0, -1.0, 1.0)[:, None])
