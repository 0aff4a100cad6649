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
BROAD = 0.05  # least width of a layer, in patch radii: a sheet seen edge-on is a line
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
    axes = np.linalg.eigh(offset.swapaxes(1, 2) @ offset)[1]
    out = Layers(
        np.zeros(m, bool), np.ones((m, k), bool), axes[:, :, 0].copy(), np.zeros(m), np.zeros(m)
    )
    rough = _Quadric.over(local[:, :fitted], axes).rest.std(1) > RIPPLE
    rows = np.flatnonzero(rough)
    if len(rows):
        found = _two_layers(local[rows], axes[rows], fitted)
        out.layered[rows], out.own[rows], out.away[rows] = found.layered, found.own, found.away
        out.gap[rows] = found.gap * radius[rows]
        out.spread[rows] = found.spread * radius[rows]
    return out


def _two_layers(local: Array, axes: Array, fitted: int) -> Layers:
    """`split` for rough patches, in units of their radius."""
    near = local[:, :fitted]
    quadric = _Quadric.over(near, axes)
    # A flat start fails on bent walls, a bent one where the far layer fills the middle only.
    flat = quadric.parted(_halves(quadric.height))
    bent = quadric.parted(_halves(quadric.rest))
    upper = np.where((bent[2] < flat[2])[:, None], bent[0], flat[0])
    gap = np.where(bent[2] < flat[2], bent[1], flat[1])
    # Once more over the planes that the layers agree on.
    axes = _tilted(axes, quadric.coefficients(upper, gap))
    quadric = _Quadric.over(near, axes)
    upper, gap, _ = quadric.parted(upper)
    height, basis = _coordinates(local, axes)
    middle = (basis @ quadric.coefficients(upper, gap)[..., None])[..., 0]
    flip = np.where(gap < 0, -1.0, 1.0)
    away, gap = (height - middle) * flip[:, None], gap * flip
    above = away[:, :1] > 0
    own = (away > 0) == above
    # The side walls of a plate lie on neither layer.
    own &= np.abs(np.abs(away) - gap[:, None] / 2) < 0.35 * gap[:, None]
    own[:, 0] = True
    layered, spread = _judged(near, away[:, :fitted], gap)
    normal = axes[:, :, 0] * (flip * np.where(above[:, 0], 1.0, -1.0))[:, None]
    return Layers(layered, own, normal, gap, spread)


@dataclass(frozen=True)
class _Quadric:
    """Quadrics over m patches: heights (m, k), monomials (m, k, 6), an orthonormal basis of these,
    and the rest (m, k) that no quadric explains."""

    height: Array
    monomials: Array
    basis: Array
    rest: Array

    @classmethod
    def over(cls, local: Array, axes: Array) -> _Quadric:
        height, monomials = _coordinates(local, axes)
        basis = np.linalg.qr(monomials)[0]
        return cls(height, monomials, basis, _without(height, basis))

    def parted(self, upper: Mask) -> tuple[Mask, Array, Array]:
        """Members of the upper layer (m, k), the gap (m,) and what is left (m,), by alternation."""
        for _ in range(ROUNDS):
            side = np.where(upper, 0.5, -0.5)
            free = _without(side, self.basis)
            length = np.maximum((free * free).sum(1), 1e-12)
            gap = (free * self.rest).sum(1) / length
            left = self.rest - gap[:, None] * free
            upper = (left + gap[:, None] * side > 0) == (gap[:, None] > 0)
        return upper, gap, np.asarray((left**2).mean(1))

    def coefficients(self, upper: Mask, gap: Array) -> Array:
        """(m, 6) of the quadric between the layers, damped so that patches on a line have one."""
        turned = self.monomials.swapaxes(1, 2)
        gram = turned @ self.monomials
        gram += 1e-9 * np.trace(gram, axis1=1, axis2=2)[:, None, None] * np.eye(6)
        middle = self.height - np.where(upper, 0.5, -0.5) * gap[:, None]
        return np.asarray(np.linalg.solve(gram, turned @ middle[..., None])[..., 0])


def _without(values: Array, basis: Array) -> Array:
    """Rows (m, k) less what the columns of an orthonormal basis (m, k, b) explain of them."""
    explained = basis @ (basis.swapaxes(1, 2) @ values[..., None])
    return np.asarray(values - explained[..., 0])


def _judged(local: Array, away: Array, gap: Array) -> tuple[Mask, Array]:
    """Whether two clusters of heights are two layers, and the spread within them."""
    upper = away > 0
    within = np.abs(away) - gap[:, None] / 2
    # Of the broader cluster: beside a junction one is tight and the other is the standing sheet.
    spread = 1.25 * np.maximum(_mean_over(upper, within), _mean_over(~upper, within))
    valley = (np.abs(away) < gap[:, None] / 4).mean(1)
    count = upper.sum(1)
    fewest = np.minimum(count, upper.shape[1] - count)
    (middle, width), (other, other_width) = (_extent(side, local) for side in (upper, ~upper))
    along = np.sqrt(np.maximum(((middle - other) ** 2).sum(1) - gap**2, 0))
    layered = (
        (gap > SEPARATION * spread)
        & (valley <= VALLEY)
        & (fewest >= FEWEST)
        & (along < APART)
        & (np.minimum(width, other_width) > BROAD)
        # The point itself must lie on a layer.
        & (np.abs(within[:, 0]) < 0.25 * gap)
    )
    return layered, spread


def _extent(members: Mask, local: Array) -> tuple[Array, Array]:
    """Middle (m, 3) of the members, and their second largest standard deviation (m,)."""
    count = np.maximum(members.sum(1), 1)[:, None]
    middle = (members[:, None].astype(np.float64) @ local)[:, 0] / count
    offset = (local - middle[:, None]) * members[..., None]
    variance = np.linalg.eigvalsh(offset.swapaxes(1, 2) @ offset)[:, 1] / count[:, 0]
    return middle, np.sqrt(np.maximum(variance, 0))


def _mean_over(members: Mask, values: Array) -> Array:
    """(m,) mean |values| (m, k) of the members."""
    total = np.einsum("mk,mk->m", members, np.abs(values))
    return np.asarray(total / np.maximum(members.sum(1), 1))


def _coordinates(local: Array, axes: Array) -> tuple[Array, Array]:
    """Heights (m, k) along the first axis and quadratic monomials (m, k, 6) over the others."""
    h, v, u = np.moveaxis(local @ axes, 2, 0)
    return h, np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=2)


def _tilted(axes: Array, coefficients: Array) -> Array:
    """Axes whose first is the normal of the quadrics at their origin."""
    ones = np.ones(len(axes))
    normal = np.stack([ones, -coefficients[:, 2], -coefficients[:, 1]], axis=1)
    first = (axes @ normal[..., None])[..., 0]
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = axes[:, :, 1] - (axes[:, :, 1] * first).sum(1, keepdims=True) * first
    second /= np.maximum(np.linalg.norm(second, axis=1, keepdims=True), 1e-300)
    return np.stack([first, second, np.cross(first, second)], axis=2)


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
