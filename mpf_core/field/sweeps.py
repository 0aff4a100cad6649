"""Values, gradients and Laplacians of the sine network, each as one node of autograd's graph.

The backward passes are derived by hand (`waves`): sines and cosines are taken once, and
intermediates are overwritten where they are not needed again. Points are shared among threads and
pass in blocks that stay in a core's cache. The nodes cannot be differentiated twice.
"""

from __future__ import annotations

from typing import Any, ClassVar

import torch
from torch import Tensor
from torch.autograd import Function
from torch.autograd.function import once_differentiable

from mpf_core.field import waves
from mpf_core.parallel import shared

SMALLEST = 32  # points that are worth a thread of their own
PARAMETERS = 8

Tensors = tuple[Tensor, ...]


class _Sweep(Function):
    """A sweep block by block, and back with the parameters' derivatives summed.

    Applied to (x, precision of the products, *parameters), it gives a tuple of as many `outputs`.
    """

    forward_block: ClassVar[Any]
    backward_block: ClassVar[Any]
    outputs: ClassVar[int]
    block: ClassVar[int]

    @classmethod
    def forward(
        cls, ctx: Any, x: Tensor, precision: torch.dtype | None, *parameters: Tensor
    ) -> Tensors:
        cast = _cast(parameters, precision)

        def part(points: slice) -> list[Tensors]:
            return [cls.forward_block(block, *cast) for block in torch.split(x[points], cls.block)]

        blocks = [one for some in shared(part, len(x), smallest=SMALLEST) for one in some]
        kept = [tensor for one in blocks for tensor in one[cls.outputs :]]
        ctx.save_for_backward(x, *parameters, *kept)
        ctx.precision = precision
        ctx.lengths = [one[0].shape[1] for one in blocks]
        return tuple(torch.cat([one[k] for one in blocks], 1) for k in range(cls.outputs))

    @classmethod
    @once_differentiable
    def backward(cls, ctx: Any, *bars: Tensor) -> tuple[Tensor | None, ...]:
        x, *rest = ctx.saved_tensors
        parameters, kept = tuple(rest[:PARAMETERS]), rest[PARAMETERS:]
        cast = _cast(parameters, ctx.precision)
        each = len(kept) // len(ctx.lengths)
        ends = torch.tensor([0, *ctx.lengths]).cumsum(0).tolist()
        x_bar = torch.empty_like(x) if ctx.needs_input_grad[0] else None

        def part(blocks: slice) -> list[Tensor]:
            sums = [torch.zeros_like(p) for p in parameters]
            for k in range(blocks.start, blocks.stop):
                points = slice(ends[k], ends[k + 1])
                saved = tuple(kept[k * each : (k + 1) * each])
                some = [bar[:, points] for bar in bars]
                z1_bar = cls.backward_block(x[points], cast, saved, *some, sums)
                if x_bar is not None:
                    x_bar[points] = z1_bar @ parameters[0]
            return sums

        first, *others = shared(part, len(ctx.lengths))
        for sums in others:
            for total, more in zip(first, sums, strict=True):
                total.add_(more)
        return (x_bar, None, *first)


def _cast(parameters: Tensors, precision: torch.dtype | None) -> Tensors:
    """The parameters with the square matrices in the precision asked for their products."""
    if precision is None:
        return parameters
    w1, b1, w2, b2, v3, b3, v, offsets = parameters
    return w1, b1, w2.to(precision), b2, v3.to(precision), b3, v, offsets


class ValueSweep(_Sweep):
    """y (2, n): both heads' outputs at x (n, 3)."""

    forward_block, backward_block = waves.values, waves.values_back
    outputs, block = 1, 1024


class GradientSweep(_Sweep):
    """y (2, n) and ∇y (2, n, 3)."""

    forward_block, backward_block = waves.gradients, waves.gradients_back
    outputs, block = 2, 1024


class LaplacianSweep(_Sweep):
    """y (2, n), ∇y (2, n, 3) and Δy (2, n)."""

    forward_block, backward_block = waves.laplacians, waves.laplacians_back
    outputs, block = 3, 256
