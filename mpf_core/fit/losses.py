"""The eight terms of the paper, one function each, and the regression of the warm start.

All are means over the points given, so that their weights do not depend on how many are drawn.
Lengths are in normalised units ([-1, 1]³).
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from mpf_core.field import FieldJets, Jet

Scalar = Float[Tensor, ""]

# Directions are v / √(|v|² + SOFT²): close to v/|v| where |v| ≈ 1, and with a bounded derivative
# where ∇r vanishes, as it does on the surface; v/(|v| + ε) with a small ε makes fits explode there.
SOFT = 0.1
TINY = 1e-8
SCALE = 0.03  # of the regression: a few spacings


def zero_loss(fields: FieldJets) -> Scalar:
    """Surface data: r + |φ| at the samples (eq. zero_level)."""
    return (fields.r.value + fields.phi.value.abs()).mean()


def align_loss(
    r: Jet, theta: Jet, alpha: float, layered: Float[Tensor, " n"] | None = None
) -> Scalar:
    """Near-surface agreement of the directions of ∇r and ∇θ, blind to orientation (eq. align).

    Weighted by exp(−α·r), so that only a narrow band around the samples counts. The weight takes
    part in the derivative: where θ must fold, between the two walls of a shell, r may rise and
    release the term. Held fixed, it drives the second wall away from the first. Where
    `layered` is 1, not 0, it is also weighted by |∇θ|² if that is below 1, which is held fixed:
    there θ folds and has no direction, and the gradients of what it has instead are noise.
    """
    of_theta = _gradient(theta)
    cosine = (_direction(_gradient(r)) * _direction(of_theta)).sum(1)  # (n,)
    window = torch.exp(-alpha * r.value)
    if layered is not None:
        steep = of_theta.detach().square().sum(1).clamp(max=1)
        window = window * torch.where(layered == 1, steep, 1.0)
    return (window * (1 - cosine.abs())).mean()


def metric_eikonal_loss(r: Jet) -> Scalar:
    """‖∇r‖ = 1 in the band off the surface (eq. eik_r)."""
    return (_norm(_gradient(r)) - 1).abs().mean()


def interface_eikonal_loss(phi: Jet, theta: Jet) -> Scalar:
    """‖∇φ‖ = 1 and ‖∇θ‖ = 1 at the samples (eq. eik_phi)."""
    return (_norm(_gradient(phi)) - 1).abs().mean() + (_norm(_gradient(theta)) - 1).abs().mean()


def laplacian_loss(phi: Jet) -> Scalar:
    """φ close to harmonic in space: |Δφ| (eq. lap)."""
    if phi.laplacian is None:
        raise ValueError("the Laplacian term needs jets of order LAPLACIAN")
    return phi.laplacian.abs().mean()


def phase_loss(indicator: Jet, side: Float[Tensor, " n"] | None = None) -> Scalar:
    """P saturated away from the surface: (1 − |P|)² (eq. phase_sat).

    Where the side s = ±1 of free space is known, (1 − s·P)², which also moves pockets of the
    wrong sign; s = 0 falls back to the paper's form.
    """
    p = indicator.value
    if side is None:
        return (1 - p.abs()).square().mean()
    return (1 - torch.where(side == 0, p.abs(), side * p)).square().mean()


def far_loss(fields: FieldJets, alpha: float) -> Scalar:
    """No zero level far from the samples: exp(−α(r + |φ|)) (eq. far_field)."""
    return torch.exp(-alpha * (fields.r.value + fields.phi.value.abs())).mean()


def normal_loss(phi: Jet, normals: Float[Tensor, "n 3"], *, oriented: bool = False) -> Scalar:
    """∇φ along the PCA normal, blind to its orientation (eq. normal_align).

    `oriented` compares signs as well, for normals that a warm start has made consistent: it keeps
    φ from touching zero at the samples without crossing it, which opens holes in sheets. A normal's
    length is its weight: one of length 0 asks nothing.
    """
    cosine = (_direction(_gradient(phi)) * normals).sum(1)
    return (normals.square().sum(1).sqrt() - (cosine if oriented else cosine.abs())).mean()


def regression_loss(
    fields: FieldJets, theta: Float[Tensor, " n"], r: Float[Tensor, " n"], scale: float = SCALE
) -> Scalar:
    """Distance of θ and r from the classical start (not in the paper).

    Errors count less far from the surface: divided by 1 + |target| / scale. What θ is beyond zero,
    on the wrong side, counts in full: or a fit of a few hundred steps leaves a body hollow.
    """
    discount = 1 / (1 + theta.abs() / scale)
    wrong = (-theta.sign() * fields.theta.value).relu()
    of_theta = (fields.theta.value - theta).abs() * discount + wrong * (1 - discount)
    of_r = (fields.r.value - r).abs() / (1 + r / scale)
    return (10 * of_theta + 3 * of_r).mean()


def _gradient(jet: Jet) -> Float[Tensor, "n 3"]:
    if jet.gradient is None:
        raise ValueError("this term needs jets of order GRADIENT")
    return jet.gradient


def _norm(v: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
    return (v.square().sum(1) + TINY**2).sqrt()


def _direction(v: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
    return v / (v.square().sum(1, keepdim=True) + SOFT**2).sqrt()
