"""One block of points through the sine network, forwards and back, derived by hand.

Letters: n points, h width; x (n, 3); z pre-activations, s = sin z, c = cos z; W₁ (h, 3), W₂
(h, h), both heads' third layers V (2, h, h) with biases (2, h), output weights v (2, h), offsets
(2); y (2, n) the outputs. In reverse from y, a and t are its derivatives with respect to z and s
of a layer (gradients); forwards from x, t (3, …) and l are ∂/∂x and Δ of s (Laplacians). A bar
marks the derivative of the loss with respect to a quantity.

Parameters are always (W₁, b₁, W₂, b₂, V, b₃, v, offsets), and `sums` their derivatives, which the
backward halves add to. Backward halves may overwrite what the forward halves kept; they return z̄₁.

W₂ and V may be given in bfloat16: all products with them, and those that make their derivatives,
are then taken in it, with sums in single precision inside a product, and everything else in single
precision. A tilde, `_low`, marks what is kept in their precision.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

Tensors = tuple[Tensor, ...]


def values(x: Tensor, *parameters: Tensor) -> Tensors:
    """y, then what the backward half needs."""
    y, _, s1_low, c1, _, s2_low, c2, s3, c3 = _upwards(x, parameters)
    return y, s1_low, c1, s2_low, c2, s3, c3


def values_back(
    x: Tensor, parameters: Tensors, kept: Tensors, y_bar: Tensor, sums: list[Tensor]
) -> Tensor:
    """From ȳ (2, n)."""
    v = parameters[6]
    s1_low, c1, s2_low, c2, s3, c3 = kept
    _add_outputs(sums, y_bar, s3)
    z3_bar = c3.mul_(y_bar[:, :, None]).mul_(v[:, None])  # (2, n, h)
    z2_bar = _heads_back(parameters, s2_low, z3_bar, sums).mul_(c2)
    z1_bar = _shared_back(parameters, s1_low, z2_bar, sums).mul_(c1)
    return _input_back(x, z1_bar, sums)


def gradients(x: Tensor, *parameters: Tensor) -> Tensors:
    """y and ∇y by a reverse sweep, then what the backward half needs."""
    w1, _, w2, _, v3, _, v, _ = parameters
    y, s1, s1_low, c1, s2, s2_low, c2, s3, c3 = _upwards(x, parameters)
    a3_low = (c3 * v[:, None]).to(v3.dtype)  # (2, n, h)
    t2 = _product(a3_low, v3)
    a2_low = (t2 * c2).to(w2.dtype)
    t1 = _product(a2_low, w2)
    a1 = t1 * c1
    return y, a1 @ w1, s1, s1_low, c1, s2, s2_low, c2, s3, c3, a3_low, t2, a2_low, t1, a1


def gradients_back(
    x: Tensor,
    parameters: Tensors,
    kept: Tensors,
    y_bar: Tensor,
    g_bar: Tensor,
    sums: list[Tensor],
) -> Tensor:
    """From ȳ (2, n) and the bar of ∇y (2, n, 3)."""
    w1, _, w2, _, v3, _, v, _ = parameters
    s1, s1_low, c1, s2, s2_low, c2, s3, c3, a3_low, t2, a2_low, t1, a1 = kept
    # Back along the reverse sweep, from ∇y to the third layer.
    sums[0].addmm_(a1.flatten(0, 1).t(), g_bar.flatten(0, 1))
    a1_bar = g_bar @ w1.t()
    c1_bar = _over_heads(t1, a1_bar)
    t1_bar = a1_bar.mul_(c1).to(w2.dtype)
    _add_product(sums[2], a2_low.flatten(0, 1).t(), t1_bar.flatten(0, 1))
    a2_bar = _product(t1_bar, w2.t())
    c2_bar = _over_heads(t2, a2_bar)
    t2_bar = a2_bar.mul_(c2).to(v3.dtype)
    for k in range(2):
        _add_product(sums[4][k], a3_low[k].t(), t2_bar[k])
    a3_bar = _product(t2_bar, v3.mT)
    # Back along the values, from the third layer to the first.
    _add_outputs(sums, y_bar, s3)
    sums[6].add_((a3_bar * c3).sum(1))
    z3_bar = c3.mul_(y_bar[:, :, None]).sub_(a3_bar.mul_(s3)).mul_(v[:, None])
    z2_bar = _heads_back(parameters, s2_low, z3_bar, sums).mul_(c2).sub_(c2_bar.mul_(s2))
    z1_bar = _shared_back(parameters, s1_low, z2_bar, sums).mul_(c1).sub_(c1_bar.mul_(s1))
    return _input_back(x, z1_bar, sums)


def laplacians(x: Tensor, *parameters: Tensor) -> Tensors:
    """y, ∇y and Δy, with (∂x, ∂y, ∂z, Δ) carried forwards, then what the backward half needs."""
    w1, _, w2, _, v3, _, v, _ = parameters
    y, s1, s1_low, c1, s2, s2_low, c2, s3, c3 = _upwards(x, parameters)
    q1 = torch.cat([w1.t(), w1.new_zeros(1, len(w1))])[:, None].expand(4, *s1.shape)
    d1_low = _bent(q1, s1, c1).to(w2.dtype)
    q2 = _product(d1_low, w2.t())  # (4, n, h)
    d2_low = _bent(q2, s2, c2).to(v3.dtype)
    q3 = _product(d2_low.flatten(0, 1), v3.mT)  # (2, 4n, h)
    q3 = q3.view(2, 4, *s1.shape)
    d3 = torch.stack([_bent(q3[k], s3[k], c3[k]) for k in range(2)])  # (2, 4, n, h)
    d = torch.einsum("kinh,kh->kin", d3, v)
    kept = (s1, s1_low, c1, s2, s2_low, c2, s3, c3, d1_low, q2, d2_low, q3, d3)
    return y, d[:, :3].mT, d[:, 3], *kept


def laplacians_back(
    x: Tensor,
    parameters: Tensors,
    kept: Tensors,
    y_bar: Tensor,
    g_bar: Tensor,
    l_bar: Tensor,
    sums: list[Tensor],
) -> Tensor:
    """From ȳ (2, n), the bar of ∇y (2, n, 3) and that of Δy (2, n)."""
    w1, _, w2, _, v3, _, v, _ = parameters
    s1, s1_low, c1, s2, s2_low, c2, s3, c3, d1_low, q2, d2_low, q3, d3 = kept
    d_bar = torch.cat([g_bar.mT, l_bar[:, None]], 1)  # (2, 4, n)
    sums[6].add_(torch.einsum("kinh,kin->kh", d3, d_bar))
    _add_outputs(sums, y_bar, s3)
    d2_bar = torch.zeros_like(q2)
    z3_bar = torch.empty_like(s3)
    for k in range(2):
        d3_bar = d_bar[k, :, :, None] * v[k]
        q3_bar, z3_bar[k] = _bent_back(d3_bar, y_bar[k, :, None] * v[k], q3[k], s3[k], c3[k])
        q3_bar = q3_bar.to(v3.dtype)
        _add_product(sums[4][k], q3_bar.flatten(0, 1).t(), d2_low.flatten(0, 1))
        d2_bar.add_(q3_bar @ v3[k])
    s2_bar = _heads_back(parameters, s2_low, z3_bar, sums)
    q2_bar, z2_bar = _bent_back(d2_bar, s2_bar, q2, s2, c2)
    q2_bar = q2_bar.to(w2.dtype)
    _add_product(sums[2], q2_bar.flatten(0, 1).t(), d1_low.flatten(0, 1))
    d1_bar = _product(q2_bar, w2)
    s1_bar = _shared_back(parameters, s1_low, z2_bar, sums)
    q1 = torch.cat([w1.t(), w1.new_zeros(1, len(w1))])[:, None]
    q1_bar, z1_bar = _bent_back(d1_bar, s1_bar, q1, s1, c1)
    sums[0].add_(q1_bar[:3].sum(1).t())
    return _input_back(x, z1_bar, sums)


def _upwards(x: Tensor, parameters: Tensors) -> Tensors:
    """y, and of each layer s, where products need it its copy in W₂'s precision, and c."""
    w1, b1, w2, b2, v3, b3, v, offsets = parameters
    z1 = torch.addmm(b1, x, w1.t())
    s1, c1 = z1.sin(), z1.cos_()
    s1_low = s1.to(w2.dtype)
    z2 = _product(s1_low, w2.t()).add_(b2)
    s2, c2 = z2.sin(), z2.cos_()
    s2_low = s2.to(v3.dtype)
    z3 = s2.new_empty(2, *s2.shape)
    for k in range(2):
        torch.add(s2_low @ v3[k].t(), b3[k], out=z3[k])
    s3, c3 = z3.sin(), z3.cos_()
    y = torch.stack([torch.mv(s3[k], v[k]) for k in range(2)]).add_(offsets[:, None])
    return y, s1, s1_low, c1, s2, s2_low, c2, s3, c3


def _product(a: Tensor, b: Tensor) -> Tensor:
    """a @ b, whose precision is the products'; the result has at least single precision."""
    y = a @ b
    return y.float() if y.dtype is torch.bfloat16 else y


def _add_product(total: Tensor, a: Tensor, b: Tensor) -> None:
    """total += a @ b."""
    if a.dtype is total.dtype:
        total.addmm_(a, b)
    else:
        total.add_(a @ b)


def _bent(q: Tensor, s: Tensor, c: Tensor) -> Float[Tensor, "4 n h"]:
    """(∂x, ∂y, ∂z, Δ) of sin z from those of z: c·∂z, and c·Δz − s·|∇z|²."""
    return torch.cat([c * q[:3], (c * q[3] - s * q[:3].square().sum(0))[None]])


def _bent_back(d_bar: Tensor, s_bar: Tensor, q: Tensor, s: Tensor, c: Tensor) -> Tensors:
    """q̄ and z̄ of sin and `_bent`, from d̄ and s̄."""
    bend = d_bar[3]
    c_bar = (d_bar * q).sum(0)
    t_bar = c * d_bar[:3] - 2 * (s * bend) * q[:3]
    squared = q[:3].square().sum(0)
    z_bar = (s_bar - bend * squared) * c - c_bar * s
    return torch.cat([t_bar, (c * bend)[None]]), z_bar


def _add_outputs(sums: list[Tensor], y_bar: Tensor, s3: Tensor) -> None:
    sums[6].add_(torch.bmm(y_bar[:, None], s3)[:, 0])
    sums[7].add_(y_bar.sum(1))


def _heads_back(parameters: Tensors, s2_low: Tensor, z3_bar: Tensor, sums: list[Tensor]) -> Tensor:
    """s̄₂, from z̄₃ (2, n, h)."""
    v3 = parameters[4]
    sums[5].add_(z3_bar.sum(1))
    z3_bar = z3_bar.to(v3.dtype)
    for k in range(2):
        _add_product(sums[4][k], z3_bar[k].t(), s2_low)
    return _product(z3_bar[0], v3[0]).add_(z3_bar[1] @ v3[1])


def _shared_back(parameters: Tensors, s1_low: Tensor, z2_bar: Tensor, sums: list[Tensor]) -> Tensor:
    """s̄₁, from z̄₂ (n, h)."""
    w2 = parameters[2]
    sums[3].add_(z2_bar.sum(0))
    z2_bar = z2_bar.to(w2.dtype)
    _add_product(sums[2], z2_bar.t(), s1_low)
    return _product(z2_bar, w2)


def _input_back(x: Tensor, z1_bar: Tensor, sums: list[Tensor]) -> Tensor:
    sums[0].addmm_(z1_bar.t(), x)
    sums[1].add_(z1_bar.sum(0))
    return z1_bar


def _over_heads(a: Tensor, b: Tensor) -> Float[Tensor, "n h"]:
    """Σ over heads of a·b; (2, n, h) each."""
    return (a[0] * b[0]).addcmul_(a[1], b[1])
