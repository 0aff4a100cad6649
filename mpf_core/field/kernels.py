"""The loops of `fused`, compiled: each is the function of that name in `plain`, in one pass.

Rows are points; every inner loop runs along a row of units and becomes vector instructions. Arrays
are C-contiguous numpy views, float32, or uint16 that holds bfloat16 (the upper half of a float32,
rounded to the nearest, ties to even); arithmetic is in float32.

All of it stands in one file, because the compiler's cache looks no further for changes.
"""

# Loops over numpy arrays have no types that mypy could check: the compiler checks them.
# mypy: ignore-errors
# ruff: noqa: ARG001, ARG005 — what is compiled for types takes arguments for their types alone
from __future__ import annotations

import llvmlite.binding as llvm
import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.core.codegen import get_host_cpu_features
from numba.extending import intrinsic, overload

NARROW = ",-prefer-256-bit"
if not numba.config.CPU_NAME and "+avx512f" in get_host_cpu_features():
    # LLVM keeps to half of AVX-512's width for fear of lower clocks, but the products around these
    # loops take the full width anyhow: a third of the time of a sine.
    numba.config.CPU_NAME = llvm.get_host_cpu_name()
    numba.config.CPU_FEATURES = get_host_cpu_features() + NARROW

f32, u32 = np.float32, np.uint32
# Multiplications and additions may be joined; no other liberty, or `_sincos` would lose its digits.
COMPILED = {"fastmath": {"contract", "nsz"}, "nogil": True, "error_model": "numpy"}


def compiled(function):
    """The function compiled at its first call, and kept in the cache where there is one."""
    try:
        return numba.njit(cache=True, **COMPILED)(function)
    except RuntimeError:  # no folder to keep it in
        return numba.njit(**COMPILED)(function)


@intrinsic
def _plus(_context, a, b):
    """a + b, which may be summed in any order: so sums along a row run in vectors."""

    def generate(_, builder, __, args):
        return builder.fadd(*args, flags=("reassoc", "nsz", "contract"))

    return types.float32(types.float32, types.float32), generate


@intrinsic
def _bits(_context, a):
    return types.uint32(types.float32), lambda _, b, __, args: b.bitcast(args[0], ir.IntType(32))


@intrinsic
def _from_bits(_context, a):
    return types.float32(types.uint32), lambda _, b, __, args: b.bitcast(args[0], ir.FloatType())


def _wide(a):
    """One entry of an array as float32."""


@overload(_wide)
def _(a):
    if a == types.float32:
        return lambda a: a
    return lambda a: _from_bits(u32(a) << u32(16))


def _kept(a, array):
    """A float32 as an entry of the array."""


@overload(_kept)
def _(a, array):
    if array.dtype == types.float32:
        return lambda a, array: a

    def rounded(a, array):
        bits = _bits(a)
        return np.uint16((bits + u32(0x7FFF) + ((bits >> u32(16)) & u32(1))) >> u32(16))

    return rounded


# 2π in three parts, whose products with whole numbers up to 2¹² are exact (Cody and Waite).
TURN = (f32(6.28125), f32(0.0019350051879882812), f32(3.019916049e-07))
ONE_BY_TURN = f32(0.15915494309189535)
TO_WHOLE = f32(1.5 * 2**23)  # added and taken off again, it leaves the nearest whole number
SINE = (f32(-1.66666571e-01), f32(8.33301710e-03), f32(-1.98066016e-04), f32(2.60002447e-06))
COSINE = (f32(-4.99999322e-01), f32(4.16639879e-02), f32(-1.38559143e-03), f32(2.31940752e-05))


@numba.njit(**COMPILED)
def _sincos(z):
    """Sine and cosine, off by less than 1e-6 for |z| up to 1000: those of half the angle within
    ±π/2 by least-maximum polynomials, doubled. Up to 2·10⁷ they stay on the circle, as close to the
    angle as float32 holds it; beyond, `TO_WHOLE` rounds no more and they are neither (no file with
    such weights is read: `network.LARGEST_WEIGHT`)."""
    turns = (z * ONE_BY_TURN + TO_WHOLE) - TO_WHOLE
    a = f32(0.5) * (((z - turns * TURN[0]) - turns * TURN[1]) - turns * TURN[2])
    q = a * a
    s = a + a * q * (SINE[0] + q * (SINE[1] + q * (SINE[2] + q * SINE[3])))
    c = f32(1) + q * (COSINE[0] + q * (COSINE[1] + q * (COSINE[2] + q * COSINE[3])))
    return f32(2) * s * c, f32(1) - f32(2) * s * s


@compiled
def first(s, c, x, w, b):
    n, h = s.shape
    for i in range(n):
        x0, x1, x2 = x[i, 0], x[i, 1], x[i, 2]
        for j in range(h):
            sine, cosine = _sincos(b[j] + x0 * w[0, j] + x1 * w[1, j] + x2 * w[2, j])
            s[i, j] = _kept(sine, s)
            c[i, j] = _kept(cosine, c)


@compiled
def layer(s, c, b):
    n, h = s.shape
    for i in range(n):
        for j in range(h):
            sine, cosine = _sincos(_wide(c[i, j]) + b[j])
            s[i, j] = _kept(sine, s)
            c[i, j] = _kept(cosine, c)


@compiled
def output(y, s, c, b, v):
    n, heads, h = s.shape
    for i in range(n):
        for k in range(heads):
            total = f32(0)
            for j in range(h):
                sine, cosine = _sincos(_wide(c[i, k, j]) + b[k, j])
                s[i, k, j] = _kept(sine, s)
                c[i, k, j] = _kept(cosine, c)
                total = _plus(total, sine * v[k, j])
            y[k, i] = total


@compiled
def layer_back(bar, b_sum, c, s, c_bar):
    n, h = bar.shape
    for i in range(n):
        for j in range(h):
            z = _wide(bar[i, j]) * _wide(c[i, j])
            if c_bar is not None:
                z -= _wide(c_bar[i, j]) * _wide(s[i, j])
            b_sum[j] += z
            bar[i, j] = _kept(z, bar)


@compiled
def first_back(bar, w_sum, b_sum, c, s, c_bar, x):
    n, h = bar.shape
    for i in range(n):
        x0, x1, x2 = x[i, 0], x[i, 1], x[i, 2]
        for j in range(h):
            z = _wide(bar[i, j]) * _wide(c[i, j])
            if c_bar is not None:
                z -= _wide(c_bar[i, j]) * _wide(s[i, j])
            b_sum[j] += z
            w_sum[0, j] += x0 * z
            w_sum[1, j] += x1 * z
            w_sum[2, j] += x2 * z
            bar[i, j] = _kept(z, bar)


@compiled
def output_back(c, v_sum, b_sum, s, a_bar, v, y_bar):
    n, heads, h = c.shape
    for i in range(n):
        for k in range(heads):
            of_y = y_bar[k, i]
            for j in range(h):
                sine, cosine = _wide(s[i, k, j]), _wide(c[i, k, j])
                of_v, z = of_y * sine, of_y * cosine
                if a_bar is not None:
                    a = _wide(a_bar[i, k, j])
                    of_v, z = of_v + a * cosine, z - a * sine
                z *= v[k, j]
                v_sum[k, j] += of_v
                b_sum[k, j] += z
                c[i, k, j] = _kept(z, c)


@compiled
def times(a, t, c):
    n, heads, h = a.shape
    for i in range(n):
        for k in range(heads):
            for j in range(h):
                a[i, k, j] = _kept(_wide(t[i, k, j]) * _wide(c[i, j]), a)


@compiled
def times_back(a_bar, c_bar, t, c):
    n, _, h = a_bar.shape
    for i in range(n):
        for j in range(h):
            a0, a1, cosine = _wide(a_bar[i, 0, j]), _wide(a_bar[i, 1, j]), _wide(c[i, j])
            of_c = _wide(t[i, 0, j]) * a0 + _wide(t[i, 1, j]) * a1
            c_bar[i, j] = _kept(of_c, c_bar)
            a_bar[i, 0, j] = _kept(a0 * cosine, a_bar)
            a_bar[i, 1, j] = _kept(a1 * cosine, a_bar)


@compiled
def slopes(g, t, c, w):
    n, heads, h = t.shape
    for i in range(n):
        for k in range(heads):
            g0, g1, g2 = f32(0), f32(0), f32(0)
            for j in range(h):
                a = _wide(t[i, k, j]) * _wide(c[i, j])
                g0 = _plus(g0, a * w[0, j])
                g1 = _plus(g1, a * w[1, j])
                g2 = _plus(g2, a * w[2, j])
            g[k, i, 0], g[k, i, 1], g[k, i, 2] = g0, g1, g2


@compiled
def slopes_back(t, c_bar, w_sum, c, w, g_bar):
    n, _, h = t.shape
    for i in range(n):
        p0, p1, p2 = g_bar[0, i, 0], g_bar[0, i, 1], g_bar[0, i, 2]
        r0, r1, r2 = g_bar[1, i, 0], g_bar[1, i, 1], g_bar[1, i, 2]
        # Twice along the row: in one loop there are too many arrays to be told apart at run time.
        for j in range(h):
            t0, t1, cosine = _wide(t[i, 0, j]), _wide(t[i, 1, j]), _wide(c[i, j])
            w_sum[0, j] += (p0 * t0 + r0 * t1) * cosine
            w_sum[1, j] += (p1 * t0 + r1 * t1) * cosine
            w_sum[2, j] += (p2 * t0 + r2 * t1) * cosine
        for j in range(h):
            a0 = p0 * w[0, j] + p1 * w[1, j] + p2 * w[2, j]
            a1 = r0 * w[0, j] + r1 * w[1, j] + r2 * w[2, j]
            cosine = _wide(c[i, j])
            c_bar[i, j] = _kept(_wide(t[i, 0, j]) * a0 + _wide(t[i, 1, j]) * a1, c_bar)
            t[i, 0, j] = _kept(a0 * cosine, t)
            t[i, 1, j] = _kept(a1 * cosine, t)


@compiled
def bent(d, q, s, c):
    n, _, h = d.shape
    for i in range(n):
        for j in range(h):
            q0, q1, q2 = _wide(q[i, 0, j]), _wide(q[i, 1, j]), _wide(q[i, 2, j])
            sine, cosine = _wide(s[i, j]), _wide(c[i, j])
            d[i, 0, j] = _kept(cosine * q0, d)
            d[i, 1, j] = _kept(cosine * q1, d)
            d[i, 2, j] = _kept(cosine * q2, d)
            bend = cosine * _wide(q[i, 3, j]) - sine * (q0 * q0 + q1 * q1 + q2 * q2)
            d[i, 3, j] = _kept(bend, d)


@numba.njit(**COMPILED)
def _bent_back(d0, d1, d2, bend, s_bar, q0, q1, q2, q3, s, c):
    """q̄ and z̄ of one unit at one point."""
    c_bar = d0 * q0 + d1 * q1 + d2 * q2 + bend * q3
    squared = q0 * q0 + q1 * q1 + q2 * q2
    twice = f32(2) * s * bend
    z = (s_bar - bend * squared) * c - c_bar * s
    return c * d0 - twice * q0, c * d1 - twice * q1, c * d2 - twice * q2, c * bend, z


@compiled
def bent_back(d_bar, bar, b_sum, q, s, c):
    n, _, h = d_bar.shape
    for i in range(n):
        for j in range(h):
            q0, q1, q2, q3, z = _bent_back(
                _wide(d_bar[i, 0, j]), _wide(d_bar[i, 1, j]), _wide(d_bar[i, 2, j]),
                _wide(d_bar[i, 3, j]), _wide(bar[i, j]),
                _wide(q[i, 0, j]), _wide(q[i, 1, j]), _wide(q[i, 2, j]), _wide(q[i, 3, j]),
                _wide(s[i, j]), _wide(c[i, j]),
            )  # fmt: skip
            b_sum[j] += z
            d_bar[i, 0, j] = _kept(q0, d_bar)
            d_bar[i, 1, j] = _kept(q1, d_bar)
            d_bar[i, 2, j] = _kept(q2, d_bar)
            d_bar[i, 3, j] = _kept(q3, d_bar)
            bar[i, j] = _kept(z, bar)


@compiled
def bent_first(d, w, s, c):
    n, _, h = d.shape
    for i in range(n):
        for j in range(h):
            w0, w1, w2, cosine = w[0, j], w[1, j], w[2, j], _wide(c[i, j])
            d[i, 0, j] = _kept(cosine * w0, d)
            d[i, 1, j] = _kept(cosine * w1, d)
            d[i, 2, j] = _kept(cosine * w2, d)
            d[i, 3, j] = _kept(-_wide(s[i, j]) * (w0 * w0 + w1 * w1 + w2 * w2), d)


@compiled
def bent_first_back(bar, w_sum, b_sum, d_bar, w, s, c, x):
    n, _, h = d_bar.shape
    for i in range(n):
        x0, x1, x2 = x[i, 0], x[i, 1], x[i, 2]
        for j in range(h):
            q0, q1, q2, _, z = _bent_back(
                _wide(d_bar[i, 0, j]), _wide(d_bar[i, 1, j]), _wide(d_bar[i, 2, j]),
                _wide(d_bar[i, 3, j]), _wide(bar[i, j]),
                w[0, j], w[1, j], w[2, j], f32(0), _wide(s[i, j]), _wide(c[i, j]),
            )  # fmt: skip
            b_sum[j] += z
            w_sum[0, j] += q0 + x0 * z
            w_sum[1, j] += q1 + x1 * z
            w_sum[2, j] += q2 + x2 * z
            bar[i, j] = _kept(z, bar)


@compiled
def bent_output(d, q, s, c, v):
    n, heads, h = s.shape
    for i in range(n):
        for k in range(heads):
            d0, d1, d2, d3 = f32(0), f32(0), f32(0), f32(0)
            for j in range(h):
                q0, q1, q2 = _wide(q[i, 0, k, j]), _wide(q[i, 1, k, j]), _wide(q[i, 2, k, j])
                steep, flat = _wide(c[i, k, j]) * v[k, j], _wide(s[i, k, j]) * v[k, j]
                d0 = _plus(d0, steep * q0)
                d1 = _plus(d1, steep * q1)
                d2 = _plus(d2, steep * q2)
                squared = q0 * q0 + q1 * q1 + q2 * q2
                d3 = _plus(d3, steep * _wide(q[i, 3, k, j]) - flat * squared)
            d[k, i, 0], d[k, i, 1], d[k, i, 2], d[k, i, 3] = d0, d1, d2, d3


@compiled
def bent_output_back(q, c, v_sum, b_sum, s, v, y_bar, d_bar):
    n, heads, h = s.shape
    for i in range(n):
        for k in range(heads):
            of_y = y_bar[k, i]
            d0, d1, d2, d3 = d_bar[k, i, 0], d_bar[k, i, 1], d_bar[k, i, 2], d_bar[k, i, 3]
            for j in range(h):
                q0, q1, q2 = _wide(q[i, 0, k, j]), _wide(q[i, 1, k, j]), _wide(q[i, 2, k, j])
                q3, sine, cosine = _wide(q[i, 3, k, j]), _wide(s[i, k, j]), _wide(c[i, k, j])
                squared = q0 * q0 + q1 * q1 + q2 * q2
                of_c = d0 * q0 + d1 * q1 + d2 * q2 + d3 * q3
                v_sum[k, j] += sine * (of_y - d3 * squared) + cosine * of_c
                q0, q1, q2, q3, z = _bent_back(d0, d1, d2, d3, of_y, q0, q1, q2, q3, sine, cosine)
                z *= v[k, j]
                b_sum[k, j] += z
                q[i, 0, k, j] = _kept(q0 * v[k, j], q)
                q[i, 1, k, j] = _kept(q1 * v[k, j], q)
                q[i, 2, k, j] = _kept(q2 * v[k, j], q)
                q[i, 3, k, j] = _kept(q3 * v[k, j], q)
                c[i, k, j] = _kept(z, c)


@compiled
def first_sine(s, x, w, b):
    n, h = s.shape
    for i in range(n):
        x0, x1, x2 = x[i, 0], x[i, 1], x[i, 2]
        for j in range(h):
            s[i, j] = _sincos(b[j] + x0 * w[0, j] + x1 * w[1, j] + x2 * w[2, j])[0]


@compiled
def sine(s, b):
    n, h = s.shape
    for i in range(n):
        for j in range(h):
            s[i, j] = _sincos(s[i, j] + b[j])[0]


@compiled
def sine_output(y, z, b, v):
    n, h = z.shape
    for i in range(n):
        total = f32(0)
        for j in range(h):
            total = _plus(total, _sincos(z[i, j] + b[j])[0] * v[j])
        y[i] = total
