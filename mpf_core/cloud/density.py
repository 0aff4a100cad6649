"""How densely a cloud samples its surface, and how far normals from it can be trusted.

Measured at a few thousand points against all of them, so that it stays cheap for millions.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mpf_core.heeding import heed

_PATCH = 16  # neighbours in whose plane a normal is fitted
_LINKS = 9  # neighbours whose normals are compared
_SAME = float(np.cos(np.radians(30)))


@dataclass(frozen=True)
class Density:
    """Figures in input units.

    spacing: the gap between samples, as the median distance to the 6th neighbour divided by √2,
        which is exact on a square grid and blind to points that come in close pairs
    sparse, dense: 95 % and 5 % quantile of the distance to the 6th neighbour
    normal_reliability: share of points whose fitted normal agrees with its neighbours' within
        30°; above 0.95 on clean sheets, near 0.3 on pure noise
    """

    spacing: float
    sparse: float
    dense: float
    normal_reliability: float

    def sentences(self) -> tuple[str, ...]:
        """The figures for a report."""
        return (
            f"spacing {self.spacing:.3g} between samples",
            f"density: sixth neighbour between {self.dense:.3g} and {self.sparse:.3g} away "
            "(5 % and 95 % quantile)",
            f"normals: {self.normal_reliability:.0%} agree with their neighbours'",
        )

    def as_dict(self) -> dict[str, float]:
        """The figures as JSON carries them."""
        return asdict(self)


def measure_density(points: NDArray[np.float64], *, sample: int = 2000, seed: int = 0) -> Density:
    """The density of distinct, finite `points` (n, 3), at least 51 of them."""
    low, high = points.min(axis=0), points.max(axis=0)
    side = float((high - low).max())
    local = (points - low) / side  # squares of raw coordinates may lose all their digits
    # Neither balanced nor compact: a few thousand questions do not repay the building.
    tree = cKDTree(local, balanced_tree=False, compact_nodes=False)
    heed()
    rng = np.random.default_rng(seed)
    picked = rng.choice(len(local), min(sample, len(local)), replace=False)
    distance, index = _nearest(tree, local[picked])
    around, place = np.unique(index[:, : _LINKS + 1], return_inverse=True)
    normals = _normals(tree, local, around)[place.reshape(len(picked), _LINKS + 1)]
    agreement = np.abs(np.einsum("nk,nlk->nl", normals[:, 0], normals[:, 1:]))
    dense, median, sparse = np.quantile(distance[:, 6], [0.05, 0.5, 0.95]) * side
    return Density(
        spacing=float(median / np.sqrt(2.0)),
        sparse=float(sparse),
        dense=float(dense),
        normal_reliability=float((np.median(agreement, axis=1) > _SAME).mean()),
    )


def _nearest(
    tree: cKDTree, centres: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Distances and indices (m, 17) of the nearest points, the centre itself first."""
    distance, index = tree.query(centres, _PATCH + 1)
    return np.asarray(distance, dtype=np.float64), np.asarray(index, dtype=np.intp)


def _normals(
    tree: cKDTree, points: NDArray[np.float64], at: NDArray[np.intp]
) -> NDArray[np.float64]:
    """Unoriented unit normals (m, 3) of the planes through the neighbourhoods of points `at`."""
    patch = points[_nearest(tree, points[at])[1]]
    patch -= patch.mean(axis=1, keepdims=True)
    scatter = np.einsum("nki,nkj->nij", patch, patch)
    axes: NDArray[np.float64] = np.linalg.eigh(scatter)[1]
    return axes[:, :, 0]
