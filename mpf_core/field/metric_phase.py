"""Metric–Phase Fields: r, θ, P = tanh(βθ) and φ = r·P + θ on one SIREN (section 3 of the paper)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from mpf_core.field.jet import Jet, Order
from mpf_core.field.siren import Siren

# "A small negative value" for the phase head's last bias on closed shapes (section 3.5).
CLOSED_PHASE_OFFSET = -0.1
COMPOSITES = ("residual", "product", "phase")  # the paper's φ, and those of its ablations


@dataclass(frozen=True)
class FieldJets:
    """The four fields at n points, with derivatives up to the order asked for."""

    r: Jet
    theta: Jet
    indicator: Jet  # P
    phi: Jet


class MetricPhaseField(nn.Module):
    """The field of the paper. Coordinates and values are in normalised units ([-1, 1]³)."""

    def __init__(
        self,
        *,
        width: int = 256,
        omega: float = 30.0,
        slow: float = 0.0,
        beta: float = 50.0,
        softplus_slope: float = 100.0,
        closed: bool = False,
        composite: str = "residual",
        generator: torch.Generator | None = None,
    ):
        super().__init__()
        self.width, self.omega, self.softplus_slope = width, omega, softplus_slope
        self.composite = composite
        self.siren = Siren(width, omega, generator, slow=slow)
        self.beta = nn.Parameter(torch.tensor(float(beta)))
        if closed:
            with torch.no_grad():
                self.siren.phase_offset.fill_(CLOSED_PHASE_OFFSET)

    def forward(self, x: Float[Tensor, "n 3"], order: Order = Order.VALUE) -> FieldJets:
        """All four fields at x, differentiated exactly up to `order`."""
        raw, theta = self.siren(x, order)
        r = sharp_softplus(raw, self.softplus_slope)
        indicator = phase_indicator(theta, self.beta)
        return FieldJets(r, theta, indicator, composed(r, theta, indicator, self.composite))

    def theta(self, x: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
        """θ alone; its zero level is the surface (Proposition 1)."""
        return self.siren.phase_value(x)


def composed(r: Jet, theta: Jet, indicator: Jet, composite: str) -> Jet:
    """φ = r·P + θ, or what ablations put in its place: "product" r·P, "phase" P."""
    if composite == "residual":
        return r * indicator + theta
    if composite == "product":
        return r * indicator
    if composite == "phase":
        return indicator
    raise ValueError(f"there is no composite {composite!r}")


def sharp_softplus(raw: Jet, slope: float) -> Jet:
    """r = log(1 + exp(slope · a)) / slope ≥ 0, smooth and close to max(a, 0)."""
    gate = torch.sigmoid(slope * raw.value)
    # Not torch's softplus, which turns linear at a threshold and is off by 1e-9 there.
    value = -functional.logsigmoid(-slope * raw.value) / slope
    return raw.through(value, gate, slope * gate * (1 - gate))


def phase_indicator(theta: Jet, beta: Float[Tensor, ""]) -> Jet:
    """P = tanh(βθ), the bounded indicator of the side (eq. phase_indicator)."""
    p = torch.tanh(beta * theta.value)
    slope = beta * (1 - p * p)
    return theta.through(p, slope, -2 * beta * p * slope)
