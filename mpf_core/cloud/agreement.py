"""Whether normals fit the samples around them, and what those say where they do not.

On a smooth surface, however curved, the sum of two normals is across the line between their samples
(König and Gumhold 2009). A few neighbours are enough, since others may lie beyond a sharp edge. A
sample whose normal does not fit lies on a face of which some around know the plane: where it is the
only such plane, the sample takes their normal, and then tells others.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

# A normal fits where FITTING neighbours are within TILTED (a sine) of it, or within NOISY times
# what is usual in the cloud.
FITTING, TILTED, NOISY = 3, 0.04, 3.0
PATCH = 24  # neighbours whose planes a sample may lie on
FLAT = 0.02  # height over length from which a sample is beside a plane
VOTERS = 2  # of one plane, and more than twice those of any that is turned from it
ALIKE, OTHER = 0.97, 0.9  # cosines from which normals are of one plane, and below which of two
ROUNDS = 4
CHUNK = 4096

Array = NDArray[np.float64]


class Agreement(NamedTuple):
    """normals: (n, 3); sure: (n,) whether each fits the samples around it, or was told by them"""

    normals: Array
    sure: NDArray[np.bool_]


def agreed(
    points: Array,
    normals: Array,
    links: NDArray[np.int32],
    tree: cKDTree,
    *,
    fixed: NDArray[np.bool_],
    threads: int = -1,
) -> Agreement:
    """Unit normals (n, 3), of which those that do not fit are replaced by those of the plane that
    the samples around know, if there is one.

    fixed: (n,) those to leave as they are. So is a noisy cloud, whose planes say too little.
    """
    least = _tilt(points, normals, links)
    usual = NOISY * float(np.median(least))
    sure = np.asarray(least <= max(TILTED, usual))
    asked = np.flatnonzero(~sure & ~fixed)
    if usual > TILTED or len(asked) == 0 or len(points) <= PATCH:
        return Agreement(normals, sure)
    normals, sure = normals.copy(), sure.copy()
    around = np.asarray(tree.query(points[asked], PATCH + 1, workers=threads)[1])[:, 1:]
    for _ in range(ROUNDS):
        found = [
            _plane_around(points, normals, sure, asked[k : k + CHUNK], around[k : k + CHUNK])
            for k in range(0, len(asked), CHUNK)
        ]
        told = np.concatenate([f.sure for f in found])
        normals[asked[told]] = np.concatenate([f.normals for f in found])[told]
        sure[asked[told]] = True
        asked, around = asked[~told], around[~told]
        if not told.any() or len(asked) == 0:
            break
    return Agreement(normals, sure)


def _tilt(points: Array, normals: Array, links: NDArray[np.int32]) -> Array:
    """(n,) sine by which the third best of the neighbours is off."""
    away = points[links] - points[:, None]
    length = np.linalg.norm(away, axis=2)
    linked = length > 0
    other = normals[links]
    side = np.sign(np.einsum("nk,nlk->nl", normals, other))[:, :, None]
    across = np.abs(np.einsum("nlk,nlk->nl", normals[:, None] + side * other, away))
    tilt = np.where(linked, across / np.where(linked, length, 1), np.inf)
    return np.asarray(np.sort(tilt, axis=1)[:, FITTING - 1])


def _plane_around(
    points: Array,
    normals: Array,
    sure: NDArray[np.bool_],
    rows: NDArray[np.int64],
    index: NDArray[np.int64],
) -> Agreement:
    """For samples `rows` (m,) the normal of the plane that they share with the most of those
    around (m, k), and whether it is the only one."""
    away = points[index] - points[rows, None]
    length = np.maximum(np.linalg.norm(away, axis=2), 1e-300)
    other = normals[index]  # (m, k, 3): each one's plane is a candidate
    cosine = np.einsum("mck,mjk->mcj", other, other)
    height = np.abs(np.einsum("mck,mjk->mcj", other, away)) / length[:, None, :]
    of_plane = (np.abs(cosine) > ALIKE) & (height < FLAT) & sure[index][:, None, :]
    votes = of_plane.sum(2) * sure[index]
    each, best = np.arange(len(rows)), votes.argmax(1)
    most = votes[each, best]
    rival = np.where(np.abs(cosine[each, best]) < OTHER, votes, 0).max(1)
    turned = np.sign(cosine[each, best]) * of_plane[each, best]
    mean = np.einsum("mj,mjk->mk", turned, other)
    mean /= np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-300)
    return Agreement(mean, (most >= VOTERS) & (2 * rival < most))
