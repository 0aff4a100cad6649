"""Two layers closer together than the samples of one: told apart from one layer, noisy or curved.

In a patch that holds both sides of a thin wall the heights over a common quadric

    h(u, v) = q(u, v) ± g / 2

form two tight clusters with an empty valley between them; those of one noisy sheet form a single
broad one, those of an edge or a junction a tight and a broad one. The quadric is shared, so that
bent walls are split as flat ones are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

PATCH = 40  # neighbours fitted: some twenty of each layer
SEPARATION = 4.0  # gap over the spread within a layer; halves of a Gaussian reach 2.7, of a tube 4
VALLEY = 0.06  # largest share of the patch in the middle half of the gap; a Gaussian has 0.3
APART = 0.6  # largest distance between the layers' middles along the surface, in patch radii: a
# step has two heights as well, but side by side
FEWEST = 6  # samples of a layer
RIPPLE = 0.008  # spread about one quadric, in patch radii, below which there is nothing to split
ROUNDS = 3

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Layers:
    """What two layers explain of m patches.

    layered: (m,) whether there are two; own: (m, k) the members of the first point's layer;
    away: (m, 3) unit normals that point away from the other layer; gap: (m,) distance between the
    layers; spread: (m,) standard deviation within the layers. Without meaning where not layered.
    """

    layered: Mask
    own: Mask
    away: Array
    gap: Array
    spread: Array


def split(patches: Array) -> Layers:
    """Look for two layers in patches (m, k, 3), nearest first, each about its first point.

    The layers are fitted to the PATCH nearest; `own` is told of all k.
    """
    m, k = patches.shape[:2]
    local = patches - patches[:, :1]
    fitted = min(PATCH, k)
    radius = np.maximum(np.linalg.norm(local[:, fitted - 1], axis=1), 1e-300)
    local /= radius[:, None, None]
    offset = local[:, :fitted] - local[:, :fitted].mean(1, keepdims=True)
    axes = np.linalg.eigh(np.einsum("mki,mkj->mij", offset, offset))[1]
    out = Layers(
        np.zeros(m, bool), np.ones((m, k), bool), axes[:, :, 0].copy(), np.zeros(m), np.zeros(m)
    )
    height, basis = _coordinates(local, axes)
    rough = _residual(height[:, :fitted], basis[:, :fitted]).std(1) > RIPPLE
    rows = np.flatnonzero(rough)
    if len(rows):
        found = _two_layers(local[rows], axes[rows], fitted)
        out.layered[rows], out.own[rows], out.away[rows] = found.layered, found.own, found.away
        out.gap[rows] = found.gap * radius[rows]
        out.spread[rows] = found.spread * radius[rows]
    return out


def _two_layers(local: Array, axes: Array, fitted: int) -> Layers:
    """`split` for rough patches, in units of their radius."""
    for _ in range(2):  # the second time over the planes that the layers agree on
        height, basis = _coordinates(local, axes)
        near, over = height[:, :fitted], basis[:, :fitted]
        # A flat start fails on bent walls, a bent one where the far layer fills the middle only.
        flat = _refined(near, over, _halves(near))
        bent = _refined(near, over, _halves(_residual(near, over)))
        better = bent[1] < flat[1]
        coefficients = np.where(better[:, None], bent[0], flat[0])
        tilt = np.stack([np.ones(len(local)), -coefficients[:, 2], -coefficients[:, 1]], axis=1)
        axes = _tilted(axes, tilt)
    height, basis = _coordinates(local, axes)
    upper = np.where(better[:, None], bent[2], flat[2])
    coefficients, _, upper = _refined(height[:, :fitted], basis[:, :fitted], upper)
    away = height - np.einsum("mkb,mb->mk", basis, coefficients[:, :6])  # of the middle
    gap = coefficients[:, 6]
    flip = np.where(gap < 0, -1.0, 1.0)
    away, gap = away * flip[:, None], gap * flip
    above = away[:, :1] > 0
    own = (away > 0) == above
    # The side walls of a plate lie on neither layer.
    own &= np.abs(np.abs(away) - gap[:, None] / 2) < 0.35 * gap[:, None]
    own[:, 0] = True
    layered, spread = _judged(local[:, :fitted], away[:, :fitted], gap)
    normal = axes[:, :, 0] * (flip * np.where(above[:, 0], 1.0, -1.0))[:, None]
    return Layers(layered, own, normal, gap, spread)


def _judged(local: Array, away: Array, gap: Array) -> tuple[Mask, Array]:
    """Whether two clusters of heights are two layers, and the spread within them."""
    upper = away > 0
    within = np.abs(away) - gap[:, None] / 2
    spread = 1.48 * np.median(np.abs(within), axis=1)
    valley = (np.abs(away) < gap[:, None] / 4).mean(1)
    count = upper.sum(1)
    fewest = np.minimum(count, upper.shape[1] - count)
    middles = [
        np.einsum("mk,mki->mi", side, local) / np.maximum(side.sum(1), 1)[:, None]
        for side in (upper, ~upper)
    ]
    between = np.linalg.norm(middles[0] - middles[1], axis=1)
    along = np.sqrt(np.maximum(between**2 - gap**2, 0))
    layered = (
        (gap > SEPARATION * spread)
        & (valley <= VALLEY)
        & (fewest >= FEWEST)
        & (along < APART)
        # The point itself must lie on a layer.
        & (np.abs(within[:, 0]) < 0.25 * gap)
    )
    return layered, spread


def _coordinates(local: Array, axes: Array) -> tuple[Array, Array]:
    """Heights (m, k) along the first axis and quadratic monomials (m, k, 6) over the others."""
    h, v, u = np.moveaxis(np.einsum("mki,mia->mka", local, axes), 2, 0)
    return h, np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=2)


def _tilted(axes: Array, normal: Array) -> Array:
    """Axes turned so that the first is `normal`, given in the old axes."""
    first = np.einsum("mia,ma->mi", axes, normal)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = axes[:, :, 1] - np.einsum("mi,mi->m", axes[:, :, 1], first)[:, None] * first
    second /= np.maximum(np.linalg.norm(second, axis=1, keepdims=True), 1e-300)
    return np.stack([first, second, np.cross(first, second)], axis=2)


def _solved(height: Array, basis: Array) -> Array:
    """Least squares (m, b), slightly damped so that patches on a line have an answer."""
    gram = np.einsum("mka,mkb->mab", basis, basis)
    gram += 1e-6 * np.trace(gram, axis1=1, axis2=2)[:, None, None] * np.eye(basis.shape[2])
    right = np.einsum("mka,mk->ma", basis, height)
    return np.asarray(np.linalg.solve(gram, right[..., None])[..., 0])


def _residual(height: Array, basis: Array) -> Array:
    return np.asarray(height - np.einsum("mkb,mb->mk", basis, _solved(height, basis)))


def _refined(height: Array, basis: Array, upper: Mask) -> tuple[Array, Array, Mask]:
    """Coefficients (m, 7), the last the gap, mean square and members, by alternation."""
    for _ in range(ROUNDS):
        design = np.concatenate([basis, np.where(upper, 0.5, -0.5)[..., None]], axis=2)
        coefficients = _solved(height, design)
        middle = height - np.einsum("mkb,mb->mk", basis, coefficients[:, :6])
        upper = (middle > 0) == (coefficients[:, 6:] > 0)
    left = middle - np.where(upper, 0.5, -0.5) * coefficients[:, 6:]
    return coefficients, np.asarray((left**2).mean(1)), upper


def _halves(values: Array) -> Mask:
    """The upper of the two clusters of each row (m, k) with the least squares within."""
    k = values.shape[1]
    ordered = np.sort(values, axis=1)
    total = np.cumsum(ordered, axis=1)
    count = np.arange(1, k)
    between = total[:, :-1] ** 2 / count + (total[:, -1:] - total[:, :-1]) ** 2 / (k - count)
    least = min(4, k // 4)
    cut = between[:, least : k - 1 - least].argmax(1) + least
    rows = np.arange(len(values))
    return np.asarray(values > 0.5 * (ordered[rows, cut] + ordered[rows, cut + 1])[:, None])
