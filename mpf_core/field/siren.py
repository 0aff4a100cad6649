"""The SIREN of the paper: backbone 3→h→h and two heads h→h→1, with exact spatial derivatives.

The network is two sine layers shared by both heads, then one sine layer and a linear output for
each head (section Network Architecture). Gradients are carried by hand in reverse (cheapest for
first derivatives), Laplacians by hand forwards; both consist of plain tensor operations, so that
one ordinary backward pass differentiates a loss of them.

Letters: n points, h width. Coordinates in normalised units ([-1, 1]³).
"""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from mpf_core.field.jet import Jet, Order


class Siren(nn.Module):
    """Two raw scalar outputs, metric and phase, of one sine network.

    `omega` is ω₀, folded into the first weights (Sitzmann et al. 2020, section 3.2); the hidden
    weights carry their own factor of ω, so that a step of an optimiser has the same meaning in
    every layer and no product with ω is needed at run time.
    """

    def __init__(self, width: int, omega: float, generator: torch.Generator | None = None):
        super().__init__()

        def uniform(*shape: int, bound: float) -> nn.Parameter:
            return nn.Parameter((torch.rand(shape, generator=generator) * 2 - 1) * bound)

        hidden = math.sqrt(6 / width)
        self.input_weight = uniform(width, 3, bound=omega / 3)
        self.input_bias = uniform(width, bound=math.pi)
        self.shared_weight = uniform(width, width, bound=hidden)
        self.shared_bias = uniform(width, bound=0.1)
        self.metric_weight = uniform(width, width, bound=hidden)
        self.metric_bias = nn.Parameter(torch.zeros(width))
        self.phase_weight = uniform(width, width, bound=hidden)
        self.phase_bias = nn.Parameter(torch.zeros(width))
        self.metric_output = uniform(width, bound=hidden / 30)
        self.phase_output = uniform(width, bound=hidden / 30)
        self.metric_offset = nn.Parameter(torch.zeros(()))
        self.phase_offset = nn.Parameter(torch.zeros(()))

    def square_matrices(self) -> list[nn.Parameter]:
        """The three h×h matrices, which hold nearly all parameters."""
        return [self.shared_weight, self.metric_weight, self.phase_weight]

    def forward(self, x: Float[Tensor, "n 3"], order: Order) -> tuple[Jet, Jet]:
        """The raw metric output (before its softplus) and θ, with derivatives up to `order`."""
        if order is Order.LAPLACIAN:
            return self._with_laplacian(x)
        z1 = functional.linear(x, self.input_weight, self.input_bias)  # (n, h)
        z2 = functional.linear(z1.sin(), self.shared_weight, self.shared_bias)  # (n, h)
        s2 = z2.sin()
        zm = functional.linear(s2, self.metric_weight, self.metric_bias)  # (n, h)
        zp = functional.linear(s2, self.phase_weight, self.phase_bias)  # (n, h)
        metric = zm.sin() @ self.metric_output + self.metric_offset  # (n,)
        phase = zp.sin() @ self.phase_output + self.phase_offset  # (n,)
        if order is Order.VALUE:
            return Jet(metric), Jet(phase)
        c1, c2 = z1.cos(), z2.cos()

        def gradient(z: Tensor, weight: Tensor, output: Tensor) -> Tensor:
            to_shared = (output * z.cos()) @ weight * c2  # (n, h)
            return (to_shared @ self.shared_weight * c1) @ self.input_weight  # (n, 3)

        return (
            Jet(metric, gradient(zm, self.metric_weight, self.metric_output)),
            Jet(phase, gradient(zp, self.phase_weight, self.phase_output)),
        )

    def phase_value(self, x: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
        """θ alone: all that extraction needs, since {φ = 0} = {θ = 0} (Proposition 1)."""
        s1 = functional.linear(x, self.input_weight, self.input_bias).sin()
        s2 = functional.linear(s1, self.shared_weight, self.shared_bias).sin()
        s3 = functional.linear(s2, self.phase_weight, self.phase_bias).sin()
        return s3 @ self.phase_output + self.phase_offset

    def phase_jet(self, x: Float[Tensor, "n 3"]) -> Jet:
        """θ and ∇θ without the metric head."""
        z1 = functional.linear(x, self.input_weight, self.input_bias)
        z2 = functional.linear(z1.sin(), self.shared_weight, self.shared_bias)
        z3 = functional.linear(z2.sin(), self.phase_weight, self.phase_bias)
        value = z3.sin() @ self.phase_output + self.phase_offset
        back = (self.phase_output * z3.cos()) @ self.phase_weight * z2.cos()
        return Jet(value, (back @ self.shared_weight * z1.cos()) @ self.input_weight)

    def _with_laplacian(self, x: Float[Tensor, "n 3"]) -> tuple[Jet, Jet]:
        """Forward propagation of (∂x, ∂y, ∂z, Δ) beside the value, stacked as (4, n, h)."""
        n = len(x)
        z1 = functional.linear(x, self.input_weight, self.input_bias)
        s1, c1 = z1.sin(), z1.cos()
        tangent = c1 * self.input_weight.t()[:, None, :]  # (3, n, h)
        laplace = -s1 * self.input_weight.square().sum(1)  # (n, h)
        stacked = torch.cat([tangent, laplace[None]])  # (4, n, h)

        def sine_layer(s: Tensor, d: Tensor, weight: Tensor, bias: Tensor) -> tuple[Tensor, Tensor]:
            z = functional.linear(s, weight, bias)
            q = functional.linear(d.reshape(4 * n, -1), weight).reshape(4, n, -1)
            sin, cos = z.sin(), z.cos()
            bend = cos * q[3] - sin * q[:3].square().sum(0)
            return sin, torch.cat([cos * q[:3], bend[None]])

        s2, d2 = sine_layer(s1, stacked, self.shared_weight, self.shared_bias)

        def head(weight: Tensor, bias: Tensor, output: Tensor, offset: Tensor) -> Jet:
            s3, d3 = sine_layer(s2, d2, weight, bias)
            d = d3 @ output  # (4, n)
            return Jet(s3 @ output + offset, d[:3].t(), d[3])

        return (
            head(self.metric_weight, self.metric_bias, self.metric_output, self.metric_offset),
            head(self.phase_weight, self.phase_bias, self.phase_output, self.phase_offset),
        )
