"""The pointwise work of a sweep (`waves`) in torch operations, in any precision: the definitions.

`fused` does the same in one pass over memory each. Arrays are (n, h) or (n, 2, h), one row for each
point; what is named s, c, t, d, q or ends in `bar` may be kept in bfloat16, sums and outputs are
not. What a function changes stands first in its first line. `sum` arrays are added to.
"""

from __future__ import annotations

import torch
from torch import Tensor

NAME = "plain"


def _wide(a: Tensor) -> Tensor:
    return a.float() if a.dtype is torch.bfloat16 else a


def first(s: Tensor, c: Tensor, x: Tensor, w: Tensor, b: Tensor) -> None:
    """s, c: sine and cosine of x·w + b, from x (n, 3), w (3, h)."""
    z = torch.addmm(b, x, w)
    s.copy_(z.sin())
    c.copy_(z.cos_())


def layer(s: Tensor, c: Tensor, b: Tensor) -> None:
    """s, c: sine and cosine of z + b, from z in the place of c."""
    z = _wide(c) + b
    s.copy_(z.sin())
    c.copy_(z.cos_())


def output(y: Tensor, s: Tensor, c: Tensor, b: Tensor, v: Tensor) -> None:
    """y (2, n), s, c: those of z + b, from z in the place of c, and y = s·v."""
    z = _wide(c) + b
    sine = z.sin()
    y.copy_((sine * v).sum(2).t())
    s.copy_(sine)
    c.copy_(z.cos_())


def layer_back(bar: Tensor, b_sum: Tensor, c: Tensor, s: Tensor, c_bar: Tensor | None) -> None:
    """bar: z̄ = s̄·c − c̄·s, from s̄ in its place; and its sum."""
    _layer_back(bar, b_sum, c, s, c_bar)


def first_back(
    bar: Tensor,
    w_sum: Tensor,
    b_sum: Tensor,
    c: Tensor,
    s: Tensor,
    c_bar: Tensor | None,
    x: Tensor,
) -> None:
    """bar: z̄ as in `layer_back`; and its sum, and that of xᵀ·z̄ (3, h)."""
    w_sum.addmm_(x.t(), _layer_back(bar, b_sum, c, s, c_bar))


def output_back(
    c: Tensor,
    v_sum: Tensor,
    b_sum: Tensor,
    s: Tensor,
    a_bar: Tensor | None,
    v: Tensor,
    y_bar: Tensor,
) -> None:
    """c: z̄ = (ȳ·c − ā·s)·v, from c in its place; and its sum, and v̄'s of ȳ·s + ā·c."""
    y_bar = y_bar.t()[:, :, None]
    of_v, z_bar = y_bar * s, y_bar * c
    if a_bar is not None:
        a_bar = _wide(a_bar)
        of_v, z_bar = of_v + a_bar * c, z_bar - a_bar * s
    z_bar = z_bar * v
    v_sum.add_(of_v.sum(0))
    b_sum.add_(z_bar.sum(0))
    c.copy_(z_bar)


def times(a: Tensor, t: Tensor, c: Tensor) -> None:
    """a: t·c of both heads, from t (n, 2, h) and c (n, h)."""
    a.copy_(_wide(t) * c[:, None])


def times_back(a_bar: Tensor, c_bar: Tensor, t: Tensor, c: Tensor) -> None:
    """a_bar, c_bar: t̄ = ā·c from ā in its place, and c̄ = Σ t·ā over both heads."""
    wide = _wide(a_bar)
    c_bar.copy_((wide * t).sum(1))
    a_bar.copy_(wide * c[:, None])


def slopes(g: Tensor, t: Tensor, c: Tensor, w: Tensor) -> None:
    """g (2, n, 3): (t·c)·wᵀ of both heads."""
    g.copy_(((_wide(t) * c[:, None]) @ w.t()).transpose(0, 1))


def slopes_back(
    t: Tensor, c_bar: Tensor, w_sum: Tensor, c: Tensor, w: Tensor, g_bar: Tensor
) -> None:
    """t, c_bar: t̄ = ḡ·w·c from t in its place, c̄ = Σ t·ḡ·w; and the sum of ḡᵀ·(t·c)."""
    g_bar = g_bar.transpose(0, 1)  # (n, 2, 3)
    a_bar, wide = g_bar @ w, _wide(t)
    c_bar.copy_((wide * a_bar).sum(1))
    w_sum.add_(torch.einsum("nki,nkh->ih", g_bar, wide * c[:, None]))
    t.copy_(a_bar * c[:, None])


def bent(d: Tensor, q: Tensor, s: Tensor, c: Tensor) -> None:
    """d (n, 4, h): (∂x, ∂y, ∂z, Δ) of sin z from q, those of z: c·∂z, and c·Δz − s·|∇z|²."""
    wide = _wide(q)
    squared = wide[:, :3].square().sum(1)
    d[:, :3].copy_(c[:, None] * wide[:, :3])
    d[:, 3].copy_(c * wide[:, 3] - s * squared)


def bent_back(d_bar: Tensor, bar: Tensor, b_sum: Tensor, q: Tensor, s: Tensor, c: Tensor) -> None:
    """d_bar, bar: q̄ and z̄ of sin and `bent`, from d̄ and s̄ in their places; and z̄'s sum."""
    q_bar, z_bar = _bent_back(_wide(d_bar), _wide(bar), _wide(q), _wide(s), _wide(c))
    b_sum.add_(z_bar.sum(0))
    d_bar.copy_(q_bar)
    bar.copy_(z_bar)


def bent_first(d: Tensor, w: Tensor, s: Tensor, c: Tensor) -> None:
    """d: `bent` of the first layer, where ∇z = w (3, h) and Δz = 0."""
    bent(d, _of_first(w, s), s, c)


def bent_first_back(
    bar: Tensor,
    w_sum: Tensor,
    b_sum: Tensor,
    d_bar: Tensor,
    w: Tensor,
    s: Tensor,
    c: Tensor,
    x: Tensor,
) -> None:
    """bar: z̄, from s̄ in its place; and its sum, and that of w̄ = ∇z's bar + xᵀ·z̄."""
    q = _of_first(w, s)
    q_bar, z_bar = _bent_back(_wide(d_bar), _wide(bar), q, _wide(s), _wide(c))
    b_sum.add_(z_bar.sum(0))
    w_sum.add_(q_bar[:, :3].sum(0)).addmm_(x.t(), z_bar)
    bar.copy_(z_bar)


def bent_output(d: Tensor, q: Tensor, s: Tensor, c: Tensor, v: Tensor) -> None:
    """d (2, n, 4): `bent` of the third layers, q (n, 4, 2, h), times v."""
    full = torch.empty_like(_wide(q))
    bent(full, q, s, c)
    d.copy_(torch.einsum("nikh,kh->kni", full, v))


def bent_output_back(
    q: Tensor,
    c: Tensor,
    v_sum: Tensor,
    b_sum: Tensor,
    s: Tensor,
    v: Tensor,
    y_bar: Tensor,
    d_bar: Tensor,
) -> None:
    """q, c: q̄ and z̄ of the third layers, from q and c in their places; and z̄'s and v̄'s sums."""
    full = torch.empty_like(_wide(q))
    bent(full, q, s, c)
    v_sum.add_(torch.einsum("nikh,kni->kh", full, d_bar))
    v_sum.add_(torch.einsum("nkh,kn->kh", _wide(s), y_bar))
    d3_bar = d_bar.permute(1, 2, 0)[..., None] * v
    s3_bar = y_bar.t()[..., None] * v
    q_bar, z_bar = _bent_back(d3_bar, s3_bar, _wide(q), _wide(s), _wide(c))
    b_sum.add_(z_bar.sum(0))
    q.copy_(q_bar)
    c.copy_(z_bar)


def _layer_back(bar: Tensor, b_sum: Tensor, c: Tensor, s: Tensor, c_bar: Tensor | None) -> Tensor:
    z_bar = _wide(bar) * c
    if c_bar is not None:
        z_bar -= _wide(c_bar) * s
    b_sum.add_(z_bar.sum(0))
    bar.copy_(z_bar)
    return z_bar


def _of_first(w: Tensor, s: Tensor) -> Tensor:
    return torch.cat([w, w.new_zeros(1, w.shape[1])])[None].expand(len(s), -1, -1)


def _bent_back(
    d_bar: Tensor, s_bar: Tensor, q: Tensor, s: Tensor, c: Tensor
) -> tuple[Tensor, Tensor]:
    bend = d_bar[:, 3]
    c_bar = (d_bar * q).sum(1)
    squared = q[:, :3].square().sum(1)
    t_bar = c[:, None] * d_bar[:, :3] - 2 * (s * bend)[:, None] * q[:, :3]
    z_bar = (s_bar - bend * squared) * c - c_bar * s
    return torch.cat([t_bar, (c * bend)[:, None]], 1), z_bar
