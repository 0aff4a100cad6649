"""The SIREN of the paper: backbone 3→h→h and two heads h→h→1, with exact spatial derivatives.

The network is two sine layers shared by both heads, then one sine layer and a linear output for
each head (section Network Architecture). Gradients are carried by hand in reverse (cheapest for
first derivatives), Laplacians by hand forwards (`waves`), so that one backward pass
differentiates a loss of them.

Letters: n points, h width. Coordinates in normalised units ([-1, 1]³).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from mpf_core.field import plain
from mpf_core.field.jet import Jet, Order
from mpf_core.field.pointwise import functions, functions_of_theta
from mpf_core.field.sweeps import GradientSweep, LaplacianSweep, Part, ValueSweep, descend

SLOW = 0.25  # of ω₀: frequency of the first layer's slow units
BLOCK = 512  # points whose sines, twice 512 KiB, stay in the second cache


class Siren(nn.Module):
    """Two raw scalar outputs, metric and phase, of one sine network.

    `omega` is ω₀, folded into the first weights (Sitzmann et al. 2020, section 3.2); the hidden
    weights carry their own factor of ω, so that a step of an optimiser has the same meaning in
    every layer and no product with ω is needed at run time. The first of its units, a share `slow`
    of them, begin with a quarter of that frequency.
    """

    def __init__(
        self,
        width: int,
        omega: float,
        generator: torch.Generator | None = None,
        *,
        slow: float = 0.0,
    ):
        super().__init__()

        def uniform(*shape: int, bound: float) -> nn.Parameter:
            drawn = torch.rand(shape, generator=generator)
            # In place: without memory (`empty_network`) any other arithmetic loads a compiler.
            return nn.Parameter(drawn.mul_(2).sub_(1).mul_(bound))

        self.precision: torch.dtype | None = None  # of the hidden products in `forward`
        hidden = math.sqrt(6 / width)
        self.input_weight = uniform(width, 3, bound=omega / 3)
        self.input_weight.data[: round(slow * width)] *= SLOW
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
        parameters = self._parameters_of_sweeps()
        if order is Order.VALUE:
            (y,) = ValueSweep.apply(x, self.precision, *parameters)  # type: ignore[no-untyped-call]
            return Jet(y[0]), Jet(y[1])
        if order is Order.GRADIENT:
            y, g = GradientSweep.apply(x, self.precision, *parameters)  # type: ignore[no-untyped-call]
            return Jet(y[0], g[0]), Jet(y[1], g[1])
        y, g, laplacian = LaplacianSweep.apply(x, self.precision, *parameters)  # type: ignore[no-untyped-call]
        return Jet(y[0], g[0], laplacian[0]), Jet(y[1], g[1], laplacian[1])

    @property
    def compiled(self) -> bool:
        """Whether its sweeps run in compiled loops."""
        return functions(self.precision or self.input_weight.dtype) is not plain

    def descend(self, asked: Sequence[Part], tally: int) -> NDArray[np.float64]:
        """Add the derivatives of the loss that `asked` describes to the parameters'.

        Returns what their `bars` summed, (tally,).
        """
        parameters = self._parameters_of_sweeps()
        bars, tallied = descend(parameters, self.precision, asked, tally)
        heads = (bar for stacked in bars[4:] for bar in stacked)
        singles = (*self._shared(), *(one for pair in self._heads() for one in pair))
        for single, bar in zip(singles, (*bars[:4], *heads), strict=True):
            single.grad = bar.clone() if single.grad is None else single.grad + bar
        return tallied

    def _parameters_of_sweeps(self) -> tuple[Tensor, ...]:
        """(W₁, b₁, W₂, b₂, V, b₃, v, offsets), the heads stacked, metric first."""
        return (*self._shared(), *(torch.stack(pair) for pair in self._heads()))

    def _shared(self) -> tuple[nn.Parameter, ...]:
        return self.input_weight, self.input_bias, self.shared_weight, self.shared_bias

    def _heads(self) -> tuple[tuple[nn.Parameter, nn.Parameter], ...]:
        return (
            (self.metric_weight, self.phase_weight),
            (self.metric_bias, self.phase_bias),
            (self.metric_output, self.phase_output),
            (self.metric_offset, self.phase_offset),
        )

    def phase_value(self, x: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
        """θ alone: all that extraction needs, since {φ = 0} = {θ = 0} (Proposition 1).

        Not for training: what differentiation would need is overwritten.
        """
        loops = functions_of_theta() if x.dtype is torch.float32 else plain
        if loops is plain:
            return self._phase_value_plainly(x)
        theta = x.new_empty(len(x))
        w1 = self.input_weight.detach().t().contiguous()
        w2, w3 = self.shared_weight.detach().t(), self.phase_weight.detach().t()
        (b1, b2, b3), v = self._phase_biases(), self.phase_output.detach()
        one, other = (x.new_empty(min(len(x), BLOCK), len(b1)) for _ in range(2))
        for at in range(0, len(x), BLOCK):
            block = x[at : at + BLOCK].detach().contiguous()
            s1, s2 = one[: len(block)], other[: len(block)]
            loops.first_sine(s1, block, w1, b1)
            torch.mm(s1, w2, out=s2)
            loops.sine(s2, b2)
            torch.mm(s2, w3, out=s1)  # z₃, in the place of s₁
            loops.sine_output(theta[at : at + BLOCK], s1, b3, v)
        return theta.add_(self.phase_offset.detach())

    def _phase_biases(self) -> tuple[Tensor, Tensor, Tensor]:
        return self.input_bias.detach(), self.shared_bias.detach(), self.phase_bias.detach()

    def _phase_value_plainly(self, x: Tensor) -> Tensor:
        s1 = functional.linear(x, self.input_weight, self.input_bias).sin_()
        s2 = functional.linear(s1, self.shared_weight, self.shared_bias).sin_()
        s3 = functional.linear(s2, self.phase_weight, self.phase_bias).sin_()
        return s3 @ self.phase_output + self.phase_offset

    def phase_jet(self, x: Float[Tensor, "n 3"]) -> Jet:
        """θ and ∇θ without the metric head."""
        z1 = functional.linear(x, self.input_weight, self.input_bias)
        z2 = functional.linear(z1.sin(), self.shared_weight, self.shared_bias)
        z3 = functional.linear(z2.sin(), self.phase_weight, self.phase_bias)
        value = z3.sin() @ self.phase_output + self.phase_offset
        back = (self.phase_output * z3.cos()) @ self.phase_weight * z2.cos()
        return Jet(value, (back @ self.shared_weight * z1.cos()) @ self.input_weight)
