"""A classical signed fit to the samples: implicit moving least squares with oriented normals.

f(x) = Σ wᵢ ½(nᵢ + n̄)·(x − pᵢ) with Gaussian weights, n̄ the weighted mean normal: second-order
exact on smooth surfaces (symmetrised normals, after Öztireli et al. 2009 and Levin 2003). Of the
two sides of a thin body each has its own f, and the closer one is taken. It is the start that the
field is regressed to, never its end: the weights of the regression go to zero.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mpf_core.cloud.neighbors import Neighborhoods, nearest

NEIGHBOURS = 8
LAYERED_NEIGHBOURS = 16  # as many on each side of a thin wall
BANDWIDTH = 0.45  # of the local spacing; smaller follows noise, larger rounds edges
FOLD = 0.1  # of the spacing: by as much a face falls away from the other's plane, or rises
FACING = 0.5  # cosine; planes steeper to each other belong to other faces

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True)
class LocalDistance:
    """The local fit at n points, normalised units.

    signed: (n,) f(x); normal: (n, 3) unit n̄; edge: (n,) distance beyond the rim of the data along
    the surface, negative over the data, −∞ where no rim is near; nearest: (n,) distance to the
    nearest sample; spacing: (n,) local spacing there; first: (n,) its index; index, weight: (n, k)
    the samples that f is made of.
    """

    signed: Array
    normal: Array
    edge: Array
    nearest: Array
    spacing: Array
    first: Indices
    index: Indices
    weight: Array

    @property
    def beyond(self) -> Array:
        """(n,) distance beyond the rim of the data, 0 over the data."""
        return np.maximum(self.edge, 0.0)

    def mean(self, values: Array) -> Array:
        """(n,) the weighted mean of one value per sample."""
        return np.asarray(np.einsum("mk,mk->m", self.weight, values[self.index]))


@dataclass(frozen=True)
class LocalFit:
    """The local fit over one cloud; `normals` (n, 3) are oriented. Samples that bound a `solid`
    (n,) face away from what is behind it; others may be seen from both sides."""

    neighbours: Neighborhoods
    normals: Array
    threads: int = -1
    solid: NDArray[np.bool_] | None = None

    def at(self, x: Array) -> LocalDistance:
        """Evaluate at x (m, 3)."""
        cloud = self.neighbours
        count = LAYERED_NEIGHBOURS if cloud.layered.any() else NEIGHBOURS
        distance, index = nearest(cloud.tree, x, min(count, len(cloud.points)), self.threads)
        normals = self.normals[index]  # (m, k, 3)
        first = index[:, 0]
        spacing = np.maximum(cloud.spacing[first], 1e-12)
        along = np.einsum("mki,mi->mk", normals, normals[:, 0])
        offset = x[:, None] - cloud.points[index]  # (m, k, 3)
        # Samples whose plane is steep to the nearest one's belong to another face.
        behind = along < -FACING
        same = np.abs(along) > FACING
        if self.solid is None:
            behind[:] = False
        else:
            behind &= self.solid[index] & self.solid[first][:, None]
        same &= ~behind
        facing = normals * np.where((along < 0) & ~behind, -1.0, 1.0)[..., None]
        weight, mean, signed = _plane(distance, facing, offset, same, spacing)
        rows = np.flatnonzero(behind.any(1))
        if len(rows):
            other = _plane(distance[rows], facing[rows], offset[rows], behind[rows], spacing[rows])
            closer = np.abs(other[2]) < np.abs(signed[rows])
            rows = rows[closer]
            weight[rows], mean[rows], signed[rows] = (part[closer] for part in other)
        steep = ~same & ~behind & self._solid(index)
        rows = np.flatnonzero(steep.any(1) & self._solid(first))
        if len(rows):
            signed[rows] = _with_other_face(
                mean[rows], signed[rows], distance[rows], normals[rows],
                offset[rows], steep[rows], spacing[rows],
            )  # fmt: skip
        edge = self._edge(index, offset, mean, spacing)
        return LocalDistance(signed, mean, edge, distance[:, 0], spacing, first, index, weight)

    def _solid(self, index: Indices) -> NDArray[np.bool_]:
        if self.solid is None:
            return np.zeros(index.shape, dtype=bool)
        return np.asarray(self.solid[index])

    def _edge(self, index: Indices, offset: Array, mean: Array, spacing: Array) -> Array:
        """Signed distance along the surface to the rim of the data."""
        height = np.einsum("mki,mi->mk", offset, mean)
        lateral = np.sqrt(np.maximum((offset**2).sum(-1) - height**2, 0)).min(1)
        past = lateral - 0.9 * spacing
        edge = np.where(past > 0, past, -np.inf)
        rim: Array = self.neighbours.rim[index]  # (m, k, 3)
        at_rim: NDArray[np.bool_] = np.any(rim, axis=2)
        rows = np.flatnonzero(at_rim.any(1))
        if not len(rows):
            return edge
        rim, at_rim, offset = rim[rows], at_rim[rows], offset[rows]
        closest = rim[np.arange(len(rows)), at_rim.argmax(1)]
        # The outermost of the rim's samples that look the same way draw its line.
        alike = at_rim & (np.einsum("mki,mi->mk", rim, closest) > 0.7)
        outward = np.where(alike, np.einsum("mki,mki->mk", offset, rim), np.inf).min(1)
        # One alone is an accident of the sampling.
        outward[alike.sum(1) < 2] = -np.inf
        edge[rows] = np.maximum(edge[rows], outward - 0.15 * spacing[rows])
        return edge


def _plane(
    distance: Array, facing: Array, offset: Array, used: NDArray[np.bool_], spacing: Array
) -> tuple[Array, Array, Array]:
    """Weights (m, k) of the samples `used`, their mean normal (m, 3) and f (m,)."""
    closest = np.where(used, distance, np.inf).min(1, keepdims=True)
    fall = (distance**2 - closest**2) / (2 * (BANDWIDTH * spacing[:, None]) ** 2)
    weight = np.where(used, np.exp(-np.maximum(fall, 0)), 0.0)
    weight /= weight.sum(1, keepdims=True)
    mean = np.einsum("mk,mki->mi", weight, facing)
    mean /= np.linalg.norm(mean, axis=1, keepdims=True) + 1e-12
    symmetric = 0.5 * (facing + mean[:, None])
    return weight, mean, np.einsum("mk,mki,mki->m", weight, symmetric, offset)


def _with_other_face(
    mean: Array,
    signed: Array,
    distance: Array,
    normals: Array,
    offset: Array,
    steep: NDArray[np.bool_],
    spacing: Array,
) -> Array:
    """f (m,) of a solid whose next face, through the samples `steep` (m, k), meets this one at an
    edge: the larger of both where the edge is convex, the smaller where it is concave."""
    leader = normals[np.arange(len(steep)), steep.argmax(1)]
    other = steep & (np.einsum("mki,mi->mk", normals, leader) > FACING)
    weight, _, beyond = _plane(distance, normals, offset, other, spacing)
    # The height of the other face's samples over this face's plane.
    height = signed - np.einsum("mk,mki,mi->m", weight, offset, mean)
    convex = height < -FOLD * spacing
    concave = height > FOLD * spacing
    return np.where(
        convex, np.maximum(signed, beyond), np.where(concave, np.minimum(signed, beyond), signed)
    )
