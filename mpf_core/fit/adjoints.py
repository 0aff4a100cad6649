"""The terms of `losses` and their derivatives with respect to the network's outputs, by hand.

Compiled: autograd's graph over the small arrays of a step (a thousand of calls) took longer than
the network itself. `losses` is the definition; the tests compare the two.

Letters: n points; y (2, n) the network's outputs, a and θ, with gradients g (2, n, 3) and
Laplacians l (2, n); r = softplus(a), gate = dr/da; P = tanh(βθ), P′ = β(1 − P²); φ = ρ·P + κθ,
where ρ is r, or 1 in the ablation "phase", and κ is 1, or 0 in both ablations. A bar marks the
derivative of the weighted sum of all terms with respect to a quantity; each loop writes ȳ, ḡ, l̄.
`constants` (5,) are β, the softplus's slope, α, 1 where ρ is r, and κ. `tally` (TALLY,) collects
the unweighted sums of the terms and, last, β̄. `first` is the number of the first point in its
batch, `count` that of the samples with which a batch begins.

Constants of `losses` stand here again, because the compiler's cache looks for changes in this file
only.
"""

# Loops over numpy arrays have no types that mypy could check: the compiler checks them.
# mypy: ignore-errors
from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numba
import numpy as np

from mpf_core.field.fused import compilation
from mpf_core.field.kernels import COMPILED, compiled

TERMS = ("zero", "align", "eik_r", "eik_phi", "lap", "phase", "far", "normal", "regression")
ZERO, ALIGN, EIK_R, EIK_PHI, LAP, PHASE, FAR, NORMAL, REGRESSION = range(len(TERMS))
BETA = len(TERMS)
TALLY = BETA + 1

SOFT, TINY = 0.1, 1e-8
SCALE = 0.03  # of the regression

# Types of the arguments: F float32, D float64, i an integer; with the number of dimensions.
FORMS = {
    "values": "D1 F2 F2 F1 i D1 D1",
    "regressions": "D1 F2 F2 F1 F1 i D1 D1",
    "gradients": "D1 F2 F3 F2 F3 F2 F1 i i i D1 D1",
    "laplacians": "D1 F2 F3 F2 F2 F3 F2 D1 D1",
}


def compilations() -> Iterator[Callable[[], None]]:
    """What compiles, one after another, all of this that is not compiled yet."""
    for name, form in FORMS.items():
        if not globals()[name].signatures:
            yield compilation(globals()[name], form, None)


NONE = (0.0, 0.0, 0.0)
inline = numba.njit(**COMPILED)


@inline
def _row(rows, i):
    return float(rows[i, 0]), float(rows[i, 1]), float(rows[i, 2])


@inline
def _dot(u, v):
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


@inline
def _plus(u, a, v):
    """u + a·v"""
    return u[0] + a * v[0], u[1] + a * v[1], u[2] + a * v[2]


@inline
def _metric(a, slope):
    """r and dr/da."""
    e = math.exp(-abs(slope * a))
    r = (max(slope * a, 0.0) + math.log1p(e)) / slope
    return r, (1.0 if a > 0 else e) / (1.0 + e)


@inline
def _unit_length(v):
    """|‖v‖ − 1| and its derivative, as a factor of v."""
    norm = math.sqrt(_dot(v, v) + TINY**2)
    return abs(norm - 1.0), np.sign(norm - 1.0) / norm


@inline
def _back(theta, p, r, gate, r_bar, p_bar, phi_bar, constants):
    """ā, θ̄ and β̄ from the bars of the values of r, P and φ."""
    beta, rho, kappa = constants[0], constants[3], constants[4]
    p_bar += phi_bar * (rho * r + 1.0 - rho)
    r_bar += phi_bar * rho * p
    flat = 1.0 - p * p
    return r_bar * gate, kappa * phi_bar + p_bar * beta * flat, p_bar * theta * flat


@compiled
def values(tally, y_bar, y, side, first, weights, constants):
    """Free space: phase and far. side (m,): of all the batch, 0 where it is not known."""
    beta, slope, alpha = constants[0], constants[1], constants[2]
    rho, kappa = constants[3], constants[4]
    for i in range(y.shape[1]):
        theta = float(y[1, i])
        r, gate = _metric(float(y[0, i]), slope)
        p = math.tanh(beta * theta)
        phi = (rho * r + 1.0 - rho) * p + kappa * theta
        toward = float(side[first + i])
        if toward == 0.0:
            toward = np.sign(p)
        off = 1.0 - toward * p
        barrier = math.exp(-alpha * (r + abs(phi)))
        tally[PHASE] += off * off
        tally[FAR] += barrier
        pull = -weights[FAR] * alpha * barrier
        p_bar = -2.0 * weights[PHASE] * off * toward
        a_bar, theta_bar, beta_bar = _back(
            theta, p, r, gate, pull, p_bar, pull * np.sign(phi), constants
        )
        y_bar[0, i], y_bar[1, i] = a_bar, theta_bar
        tally[BETA] += beta_bar


@compiled
def regressions(tally, y_bar, y, theta, r, first, weights, constants):
    """The warm start: θ and r (m,) of all the batch are its targets."""
    for i in range(y.shape[1]):
        metric, gate = _metric(float(y[0, i]), constants[1])
        phase, target = float(y[1, i]), float(theta[first + i])
        of_theta = 10.0 / (1.0 + abs(target) / SCALE)
        of_r = 3.0 / (1.0 + float(r[first + i]) / SCALE)
        off_theta, off_r = phase - target, metric - r[first + i]
        theta_bar = of_theta * np.sign(off_theta)
        tally[REGRESSION] += of_theta * abs(off_theta) + of_r * abs(off_r)
        if phase * target < 0.0:
            tally[REGRESSION] += (10.0 - of_theta) * abs(phase)
            theta_bar += (10.0 - of_theta) * np.sign(phase)
        y_bar[0, i] = weights[REGRESSION] * of_r * np.sign(off_r) * gate
        y_bar[1, i] = weights[REGRESSION] * theta_bar


@inline
def _at_sample(tally, r, theta, p, of_r, of_theta, normal, oriented, weights, constants):
    """zero, eik_phi and normal at one sample: r̄, P̄, φ̄, ∇r's bar, ∇θ's, β̄."""
    beta, rho, kappa = constants[0], constants[3], constants[4]
    flat = 1.0 - p * p
    steep, carried = beta * flat, rho * r + 1.0 - rho
    phi = carried * p + kappa * theta
    through = carried * steep + kappa  # ∇φ = ρ·P·∇r + through·∇θ
    of_phi = _plus(_plus(NONE, rho * p, of_r), through, of_theta)
    tally[ZERO] += r + abs(phi)
    off_phi, of_length = _unit_length(of_phi)
    off_theta, of_length_theta = _unit_length(of_theta)
    tally[EIK_PHI] += off_phi + off_theta
    length = math.sqrt(_dot(of_phi, of_phi) + SOFT**2)
    cosine = _dot(of_phi, normal) / length
    toward = 1.0 if oriented else np.sign(cosine)
    tally[NORMAL] += math.sqrt(_dot(normal, normal)) - toward * cosine
    pull = -weights[NORMAL] * toward / length
    along = weights[EIK_PHI] * of_length - pull * cosine / length
    phi_bar = _plus(_plus(NONE, pull, normal), along, of_phi)  # of ∇φ
    theta_bar = _plus(_plus(NONE, weights[EIK_PHI] * of_length_theta, of_theta), through, phi_bar)
    through_bar = _dot(phi_bar, of_theta)
    steep_bar = through_bar * carried
    r_bar = weights[ZERO] + through_bar * rho * steep
    p_bar = rho * _dot(phi_bar, of_r) - 2.0 * beta * p * steep_bar
    r_slope_bar = _plus(NONE, rho * p, phi_bar)
    return r_bar, p_bar, weights[ZERO] * np.sign(phi), r_slope_bar, theta_bar, steep_bar * flat


@inline
def _in_band(tally, r, of_r, of_theta, layered, weights, constants):
    """eik_r and align at one point: r̄, ∇r's bar, ∇θ's."""
    off, of_length = _unit_length(of_r)
    tally[EIK_R] += off
    length_r = math.sqrt(_dot(of_r, of_r) + SOFT**2)
    length_theta = math.sqrt(_dot(of_theta, of_theta) + SOFT**2)
    cosine = _dot(of_r, of_theta) / (length_r * length_theta)
    window = math.exp(-constants[2] * r)
    if layered == 1.0:
        window *= min(_dot(of_theta, of_theta), 1.0)
    apart = window * (1.0 - abs(cosine))
    tally[ALIGN] += apart
    pull = -weights[ALIGN] * window * np.sign(cosine)
    across = pull / (length_r * length_theta)
    along = weights[EIK_R] * of_length - pull * cosine / length_r**2
    r_bar = _plus(_plus(NONE, along, of_r), across, of_theta)
    theta_bar = _plus(_plus(NONE, -pull * cosine / length_theta**2, of_theta), across, of_r)
    return -weights[ALIGN] * constants[2] * apart, r_bar, theta_bar


@compiled
def gradients(
    tally, y_bar, g_bar, y, g, normals, layered, first, count, oriented, weights, constants
):
    """Samples: zero, eik_phi and normal; then points of the band: eik_r and align.

    normals (count, 3); layered: of those of the band, 1 where align counts less at folds
    """
    slope = constants[1]
    for i in range(y.shape[1]):
        theta, k = float(y[1, i]), first + i
        r, gate = _metric(float(y[0, i]), slope)
        p = math.tanh(constants[0] * theta)
        of_a, of_theta = _row(g[0], i), _row(g[1], i)
        of_r = _plus(NONE, gate, of_a)
        p_bar, phi_bar, beta_bar = 0.0, 0.0, 0.0
        if k < count:
            r_bar, p_bar, phi_bar, r_slope_bar, theta_slope_bar, beta_bar = _at_sample(
                tally, r, theta, p, of_r, of_theta, _row(normals, k), oriented, weights, constants
            )
        else:
            r_bar, r_slope_bar, theta_slope_bar = _in_band(
                tally, r, of_r, of_theta, layered[k - count], weights, constants
            )
        a_bar, theta_bar, more = _back(theta, p, r, gate, r_bar, p_bar, phi_bar, constants)
        y_bar[0, i] = a_bar + _dot(r_slope_bar, of_a) * slope * gate * (1.0 - gate)
        y_bar[1, i] = theta_bar
        tally[BETA] += beta_bar + more
        for d in range(3):
            g_bar[0, i, d], g_bar[1, i, d] = gate * r_slope_bar[d], theta_slope_bar[d]


@compiled
def laplacians(tally, y_bar, g_bar, l_bar, y, g, lap, weights, constants):
    """Free space: lap."""
    beta, slope, rho, kappa = constants[0], constants[1], constants[3], constants[4]
    for i in range(y.shape[1]):
        theta = float(y[1, i])
        r, gate = _metric(float(y[0, i]), slope)
        p = math.tanh(beta * theta)
        flat = 1.0 - p * p
        steep = beta * flat  # P′
        bend = -2.0 * beta * p * steep  # P″
        of_a, of_theta = _row(g[0], i), _row(g[1], i)
        lap_a, lap_theta = float(lap[0, i]), float(lap[1, i])
        bend_gate = slope * gate * (1.0 - gate)
        squared_a, squared_theta = _dot(of_a, of_a), _dot(of_theta, of_theta)
        across = gate * _dot(of_a, of_theta)  # ∇r·∇θ
        lap_r = gate * lap_a + bend_gate * squared_a
        carried = rho * r + 1.0 - rho
        of_p = steep * lap_theta + bend * squared_theta  # ΔP
        of_phi = rho * (p * lap_r + 2.0 * steep * across) + carried * of_p + kappa * lap_theta
        tally[LAP] += abs(of_phi)
        bar = weights[LAP] * np.sign(of_phi)
        steep_bar = bar * (2.0 * rho * across + carried * lap_theta)
        bend_bar = bar * carried * squared_theta
        p_bar = bar * rho * lap_r - 2.0 * beta * (p * steep_bar + (steep * bend_bar))
        # P″ = −2βP·P′, and P′ = β(1 − P²)
        more_steep = -2.0 * beta * p * bend_bar
        p_bar += -2.0 * beta * p * more_steep
        beta_bar = (steep_bar + more_steep) * flat - 2.0 * p * steep * bend_bar
        lap_r_bar, across_bar = bar * rho * p, bar * rho * 2.0 * steep
        gate_bar = lap_r_bar * lap_a + across_bar * _dot(of_a, of_theta)
        gate_bar += lap_r_bar * squared_a * slope * (1.0 - 2.0 * gate)
        r_bar = bar * rho * of_p
        a_bar, theta_bar, more = _back(theta, p, r, gate, r_bar, p_bar, 0.0, constants)
        y_bar[0, i], y_bar[1, i] = a_bar + gate_bar * bend_gate, theta_bar
        tally[BETA] += beta_bar + more
        l_bar[0, i] = lap_r_bar * gate
        l_bar[1, i] = bar * (carried * steep + kappa)
        for d in range(3):
            g_bar[0, i, d] = 2.0 * lap_r_bar * bend_gate * of_a[d] + across_bar * gate * of_theta[d]
            g_bar[1, i, d] = across_bar * gate * of_a[d] + 2.0 * bar * carried * bend * of_theta[d]
