"""Values, gradients and Laplacians of the sine network, each as one node of autograd's graph.

The backward passes are derived by hand (`waves`): sines and cosines are taken once, and
intermediates are overwritten where they are not needed again. Points are shared among threads and
pass in blocks: products of few rows cost more each, as their weights are packed anew each time. The
nodes cannot be differentiated twice.

`descend` goes there and back block by block without a graph, where the derivatives of the loss with
respect to the outputs are known by themselves.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.autograd import Function
from torch.autograd.function import once_differentiable

from mpf_core.field import waves
from mpf_core.field.buffers import Buffers
from mpf_core.field.pointwise import functions
from mpf_core.field.waves import Desk, Weights
from mpf_core.parallel import shared

SMALLEST = 128  # points that are worth a thread of their own
SHARES = 1 << 20  # into which `descend` divides each part, to give each thread as many

Tensors = tuple[Tensor, ...]

_buffers = Buffers()


def forget_buffers() -> None:
    """Give back the memory that the next step would have used."""
    _buffers.clear()


class _Sweep(Function):
    """A sweep block by block, and back with the parameters' derivatives summed.

    Applied to (x, precision of the products, *parameters), it gives a tuple of outputs.
    """

    forward_block: ClassVar[Any]
    backward_block: ClassVar[Any]
    block: ClassVar[int]

    @classmethod
    def forward(
        cls, ctx: Any, x: Tensor, precision: torch.dtype | None, *parameters: Tensor
    ) -> Tensors:
        x = x.detach().contiguous()
        desk = _desk(parameters, precision)

        def part(points: slice) -> list[tuple[Tensors, Tensors]]:
            return [cls.forward_block(desk, block) for block in torch.split(x[points], cls.block)]

        blocks = [one for some in shared(part, len(x), smallest=SMALLEST) for one in some]
        ctx.save_for_backward(x, *parameters)
        ctx.desk, ctx.kept = desk, [kept for _, kept in blocks]
        outputs = zip(*(found for found, _ in blocks), strict=True)
        return tuple(torch.cat(parts, 1) for parts in outputs)

    @classmethod
    @once_differentiable
    def backward(cls, ctx: Any, *bars: Tensor) -> tuple[Tensor | None, ...]:
        x, *parameters = ctx.saved_tensors  # which complains if a parameter has changed since
        desk, blocks = ctx.desk, ctx.kept
        if blocks is None:
            raise RuntimeError("a sweep goes back once: its intermediates are overwritten then")
        ctx.kept = None
        ends = torch.tensor([0, *(len(kept[0]) for kept in blocks)]).cumsum(0).tolist()
        x_bar = torch.empty_like(x) if ctx.needs_input_grad[0] else None

        def part(some: slice) -> Weights:
            sums = _zeros(parameters)
            for k in range(some.start, some.stop):
                points = slice(ends[k], ends[k + 1])
                of_block = [bar[:, points].contiguous() for bar in bars]
                z1_bar = cls.backward_block(desk, x[points], blocks[k], sums, *of_block)
                if x_bar is not None:
                    x_bar[points] = z1_bar.to(x.dtype) @ parameters[0]
                desk.buffers.give(z1_bar, *blocks[k])
            return sums

        sums = _summed(shared(part, len(blocks)))
        return (x_bar, None, *_by_parameters(sums, parameters))


def _summed(parts: Sequence[Weights]) -> Weights:
    first, *others = parts
    for sums in others:
        for field in fields(Weights):
            getattr(first, field.name).add_(getattr(sums, field.name))
    return first


def _desk(parameters: Tensors, precision: torch.dtype | None) -> Desk:
    """The parameters with the square matrices in the precision asked for their products."""
    w1, b1, w2, b2, v3, b3, v, offsets = (p.detach() for p in parameters)
    kept = precision or w2.dtype
    u3 = (v[:, :, None] * v3).to(kept)
    w2, v3 = w2.to(kept), v3.to(kept)
    weights = Weights(w1.t().contiguous(), b1, w2, b2, v3, b3, v, offsets, u3)
    return Desk(functions(kept), _buffers, weights)


def _zeros(parameters: Tensors) -> Weights:
    w1, *others = parameters
    return Weights(*(p.new_zeros(p.shape) for p in (w1.t(), *others, parameters[4])))


def _by_parameters(sums: Weights, parameters: Tensors) -> Tensors:
    """U's part goes to V; v's part of it is in its sum already."""
    v3 = sums.v3.addcmul_(parameters[6][:, :, None], sums.u3)
    return sums.w1.t(), sums.b1, sums.w2, sums.b2, v3, sums.b3, sums.v, sums.offsets


class ValueSweep(_Sweep):
    """y (2, n): both heads' outputs at x (n, 3)."""

    forward_block, backward_block = waves.values, waves.values_back
    block = 1024


class GradientSweep(_Sweep):
    """y (2, n) and ∇y (2, n, 3)."""

    forward_block, backward_block = waves.gradients, waves.gradients_back
    block = 1024


class LaplacianSweep(_Sweep):
    """y (2, n), ∇y (2, n, 3) and Δy (2, n)."""

    forward_block, backward_block = waves.laplacians, waves.laplacians_back
    block = 128


@dataclass(frozen=True)
class Part:
    """Points (n, 3), the sweep that takes them, and what a loss asks for there.

    bars: from the sweep's outputs for the points `rows`, the derivatives of the loss with respect
    to them; what else is to be summed it adds to the array that it is given.
    """

    sweep: type[_Sweep]
    x: Tensor
    bars: Callable[[Tensors, slice, NDArray[np.float64]], Tensors]


@torch.no_grad()
def descend(
    parameters: Tensors, precision: torch.dtype | None, asked: Sequence[Part], tally: int
) -> tuple[Tensors, NDArray[np.float64]]:
    """The derivatives of a loss with respect to the parameters, summed over all parts.

    Also what their `bars` added up, (tally,). Each thread goes there and back with its share of
    every part, a block at a time, and waits for the others once.
    """
    desk = _desk(parameters, precision)

    def part(share: slice) -> tuple[Weights, NDArray[np.float64]]:
        sums, tallied = _zeros(parameters), np.zeros(tally)
        for one in asked:
            sweep, n = one.sweep, len(one.x)
            end = n * share.stop // SHARES
            for at in range(n * share.start // SHARES, end, sweep.block):
                rows = slice(at, min(at + sweep.block, end))
                x = one.x[rows]
                outputs, kept = sweep.forward_block(desk, x)
                bars = one.bars(outputs, rows, tallied)
                z1_bar = sweep.backward_block(desk, x, kept, sums, *bars)
                desk.buffers.give(z1_bar, *kept)
        return sums, tallied

    smallest = SHARES * SMALLEST // max(1, sum(len(one.x) for one in asked))
    parts = shared(part, SHARES, smallest=max(1, smallest))
    sums = _summed([sums for sums, _ in parts])
    return _by_parameters(sums, parameters), np.sum([tallied for _, tallied in parts], axis=0)
