"""One block of points through the sine network, forwards and back, derived by hand.

Letters: n points, h width; x (n, 3); z pre-activations, s = sin z, c = cos z; W₁ᵀ (3, h), W₂
(h, h), both heads' third layers V (2, h, h) with biases (2, h), output weights v (2, h), offsets
(2); y (2, n) the outputs. In reverse from y, a and t are its derivatives with respect to z and s
of a layer (gradients); forwards from x, q and d (n, 4, h) are ∂/∂x and Δ of z and s (Laplacians).
A bar marks the derivative of the loss with respect to a quantity.

What stands here is the order of the calculus and all products of matrices; what is done to each
entry by itself (sines, their slopes, sums over points) is `plain`, or one loop each, `fused`.
Each works in the place of an array that is not needed again, which its comment names. Both heads
lie side by side, (n, 2, h), so that one product serves them, wherever they have the same factor.

W₂ and V may be given in bfloat16: all arrays of a block and their products are then kept in it, and
sums, outputs and what happens to each entry in between are in single precision.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType

import torch
from jaxtyping import Float
from torch import Tensor

from mpf_core.field.buffers import Buffers

Tensors = tuple[Tensor, ...]


@dataclass(frozen=True)
class Weights:
    """The network's parameters, or the derivatives of the loss with respect to them.

    u3 is U_k = diag(v_k)·V_k, through which the reverse sweep starts: ∂y/∂s₂ = c₃·U.
    """

    w1: Float[Tensor, "3 h"]
    b1: Float[Tensor, " h"]
    w2: Float[Tensor, "h h"]
    b2: Float[Tensor, " h"]
    v3: Float[Tensor, "2 h h"]
    b3: Float[Tensor, "2 h"]
    v: Float[Tensor, "2 h"]
    offsets: Float[Tensor, 2]
    u3: Float[Tensor, "2 h h"]

    @property
    def both(self) -> Float[Tensor, "2h h"]:
        """V of both heads as one matrix."""
        return self.v3.flatten(0, 1)


@dataclass(frozen=True)
class Desk:
    """What a block is worked with: functions for entries, arrays to use again, and the weights."""

    entries: ModuleType
    buffers: Buffers
    weights: Weights

    def blank(self, *shape: int) -> Tensor:
        """An array in the precision of the products."""
        return self.buffers.take(shape, self.weights.w2.dtype)


def values(desk: Desk, x: Tensor) -> tuple[Tensors, Tensors]:
    """y; and what the backward half needs."""
    y, *kept = _upwards(desk, x)
    return (y,), tuple(kept)


def values_back(desk: Desk, x: Tensor, kept: Tensors, sums: Weights, y_bar: Tensor) -> Tensor:
    """z̄₁ from ȳ (2, n)."""
    *_, s3, c3 = kept
    sums.offsets.add_(y_bar.sum(1))
    desk.entries.output_back(c3, sums.v, sums.b3, s3, None, desk.weights.v, y_bar)  # c₃ → z̄₃
    return _downwards(desk, x, kept, (None, None), sums)


def gradients(desk: Desk, x: Tensor) -> tuple[Tensors, Tensors]:
    """y and ∇y by a reverse sweep; and what the backward half needs."""
    e, w, (n, h) = desk.entries, desk.weights, (len(x), len(desk.weights.b1))
    y, s1, c1, s2, c2, s3, c3 = _upwards(desk, x)
    t2, a2, t1 = desk.blank(n, 2, h), desk.blank(n, 2, h), desk.blank(n, 2, h)
    for k in range(2):
        torch.mm(c3[:, k], w.u3[k], out=t2[:, k])
    e.times(a2, t2, c2)
    torch.mm(a2.flatten(0, 1), w.w2, out=t1.flatten(0, 1))
    g = x.new_empty(2, n, 3)
    e.slopes(g, t1, c1, w.w1)
    return (y, g), (s1, c1, s2, c2, s3, c3, t2, a2, t1)


def gradients_back(
    desk: Desk, x: Tensor, kept: Tensors, sums: Weights, y_bar: Tensor, g_bar: Tensor
) -> Tensor:
    """z̄₁ from ȳ (2, n) and the bar of ∇y (2, n, 3)."""
    e, w, (n, h) = desk.entries, desk.weights, (len(x), len(desk.weights.b1))
    _, c1, _, c2, s3, c3, t2, a2, t1 = kept
    c1_bar, c2_bar = desk.blank(n, h), desk.blank(n, h)
    # Back along the reverse sweep, from ∇y to the third layer.
    e.slopes_back(t1, c1_bar, sums.w1, c1, w.w1, g_bar)  # t₁ → t̄₁
    _add_product(sums.w2, a2.flatten(0, 1).t(), t1.flatten(0, 1))
    torch.mm(t1.flatten(0, 1), w.w2.t(), out=a2.flatten(0, 1))  # a₂ → ā₂
    e.times_back(a2, c2_bar, t2, c2)  # ā₂ → t̄₂
    for k in range(2):
        _add_product(sums.u3[k], c3[:, k].t(), a2[:, k])
        torch.mm(a2[:, k], w.v3[k].t(), out=t2[:, k])  # t₂ → ā₃
    # Back along the values, from the third layer to the first.
    sums.offsets.add_(y_bar.sum(1))
    e.output_back(c3, sums.v, sums.b3, s3, t2, w.v, y_bar)  # c₃ → z̄₃
    z1_bar = _downwards(desk, x, kept[:6], (c1_bar, c2_bar), sums)
    desk.buffers.give(c1_bar, c2_bar)
    return z1_bar


def laplacians(desk: Desk, x: Tensor) -> tuple[Tensors, Tensors]:
    """y, ∇y and Δy, with (∂x, ∂y, ∂z, Δ) carried forwards; and what the backward half needs."""
    e, w, (n, h) = desk.entries, desk.weights, (len(x), len(desk.weights.b1))
    y, s1, c1, s2, c2, s3, c3 = _upwards(desk, x)
    d1, q2, d2 = desk.blank(n, 4, h), desk.blank(n, 4, h), desk.blank(n, 4, h)
    q3 = desk.blank(n, 4, 2, h)
    e.bent_first(d1, w.w1, s1, c1)
    torch.mm(d1.flatten(0, 1), w.w2.t(), out=q2.flatten(0, 1))
    e.bent(d2, q2, s2, c2)
    torch.mm(d2.flatten(0, 1), w.both.t(), out=q3.view(4 * n, 2 * h))
    d = x.new_empty(2, n, 4)
    e.bent_output(d, q3, s3, c3, w.v)
    return (y, d[:, :, :3], d[:, :, 3]), (s1, c1, s2, c2, s3, c3, d1, q2, d2, q3)


def laplacians_back(
    desk: Desk,
    x: Tensor,
    kept: Tensors,
    sums: Weights,
    y_bar: Tensor,
    g_bar: Tensor,
    l_bar: Tensor,
) -> Tensor:
    """z̄₁ from ȳ (2, n), the bar of ∇y (2, n, 3) and that of Δy (2, n)."""
    e, w, (n, h) = desk.entries, desk.weights, (len(x), len(desk.weights.b1))
    s1, c1, s2, c2, s3, c3, d1, q2, d2, q3 = kept
    d_bar = torch.cat([g_bar, l_bar[:, :, None]], 2)  # (2, n, 4)
    sums.offsets.add_(y_bar.sum(1))
    e.bent_output_back(q3, c3, sums.v, sums.b3, s3, w.v, y_bar, d_bar)  # q₃ → q̄₃, c₃ → z̄₃
    q3_bar, z3_bar = q3.view(4 * n, 2 * h), c3.flatten(1)
    d1_bar, s2_bar, s1_bar = desk.blank(n, 4, h), desk.blank(n, h), desk.blank(n, h)
    _add_product(sums.both, q3_bar.t(), d2.flatten(0, 1))
    _add_product(sums.both, z3_bar.t(), s2)
    torch.mm(q3_bar, w.both, out=d2.flatten(0, 1))  # d₂ → d̄₂
    torch.mm(z3_bar, w.both, out=s2_bar)
    e.bent_back(d2, s2_bar, sums.b2, q2, s2, c2)  # d̄₂ → q̄₂, s̄₂ → z̄₂
    _add_product(sums.w2, d2.flatten(0, 1).t(), d1.flatten(0, 1))
    _add_product(sums.w2, s2_bar.t(), s1)
    torch.mm(d2.flatten(0, 1), w.w2, out=d1_bar.flatten(0, 1))
    torch.mm(s2_bar, w.w2, out=s1_bar)
    e.bent_first_back(s1_bar, sums.w1, sums.b1, d1_bar, w.w1, s1, c1, x)  # s̄₁ → z̄₁
    desk.buffers.give(d1_bar, s2_bar)
    return s1_bar


def _upwards(desk: Desk, x: Tensor) -> Tensors:
    """y, and s and c of each layer; z is made in the place of c."""
    e, w, (n, h) = desk.entries, desk.weights, (len(x), len(desk.weights.b1))
    s1, c1, s2, c2 = (desk.blank(n, h) for _ in range(4))
    s3, c3, y = desk.blank(n, 2, h), desk.blank(n, 2, h), x.new_empty(2, n)
    e.first(s1, c1, x, w.w1, w.b1)
    torch.mm(s1, w.w2.t(), out=c2)
    e.layer(s2, c2, w.b2)
    torch.mm(s2, w.both.t(), out=c3.flatten(1))
    e.output(y, s3, c3, w.b3, w.v)
    return y.add_(w.offsets[:, None]), s1, c1, s2, c2, s3, c3


def _downwards(
    desk: Desk, x: Tensor, kept: Tensors, c_bars: tuple[Tensor | None, ...], sums: Weights
) -> Tensor:
    """z̄₁ from z̄₃ in the place of c₃, and c̄₁ and c̄₂ where cosines had a part."""
    e, w, (n, h) = desk.entries, desk.weights, (len(x), len(desk.weights.b1))
    s1, c1, s2, c2, _, c3 = kept
    z3_bar, s2_bar, s1_bar = c3.flatten(1), desk.blank(n, h), desk.blank(n, h)
    _add_product(sums.both, z3_bar.t(), s2)
    torch.mm(z3_bar, w.both, out=s2_bar)
    e.layer_back(s2_bar, sums.b2, c2, s2, c_bars[1])  # s̄₂ → z̄₂
    _add_product(sums.w2, s2_bar.t(), s1)
    torch.mm(s2_bar, w.w2, out=s1_bar)
    e.first_back(s1_bar, sums.w1, sums.b1, c1, s1, c_bars[0], x)  # s̄₁ → z̄₁
    desk.buffers.give(s2_bar)
    return s1_bar


def _add_product(total: Tensor, a: Tensor, b: Tensor) -> None:
    """total += a @ b."""
    if a.dtype is total.dtype:
        total.addmm_(a, b)
    else:
        total.add_(a @ b)
