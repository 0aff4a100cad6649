"""Quadrics fitted to the samples around a point that face its way: the surface under noise.

Weighted least squares of height over the tangent plane, z(u, v) with six coefficients, weights
exp(−(u² + v² + c z²)/2k² − |n − nᵢ|²/σ²) (the normals' part after Öztireli et al. 2009): across an
edge, or through a thin wall, samples of the other side have no say. Heights count little (c), or a
sample would be drawn to those that noise has moved its way.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mpf_core.cloud.neighbors import nearest
from mpf_core.heeding import ROWS_AT_ONCE, in_parts

FACING = 0.35  # σ: a sample turned by 20° has a third of the weight, by 40° a fiftieth
HEIGHT = 0.1  # c
# Kernels k tried, over the spacing, with neighbours that reach far enough for each: six unknowns
# need the first on clean data, noise asks for more.
KERNELS = ((0.8, 24), (1.2, 50), (1.8, 110), (2.4, 200), (3.2, 360), (4.2, 620))
RIDGE = 1e-3  # on curvatures, of the weight: decides only where there are too few samples
NEGLIGIBLE = 2e-3  # of the spacing: errors below need no wider kernel
NOTICED = 0.03  # of the spacing: less noise is not worth looking at the samples twice
CURVED = 1.25  # of the narrowest kernel's error, that of the next if the surface bends (≥ 1.46 on
# clean clouds, ≤ 1.13 with noise of a fortieth of the spacing or more)
BETTER = 0.999  # of the error, at most, that a wider kernel must leave to be taken
OUTLYING = 3.0  # medians of the errors, beyond which they count no more: edges and rims
PROBES = 3000  # samples at which kernels are judged
PAIRS = 32_000_000  # of points and neighbours: what a fit to all may cost, some seconds
AT_ONCE = 400_000  # of them on each thread: some 150 MB of temporaries

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True)
class Samples:
    """What quadrics are fitted to: points, unit normals (n, 3), oriented where sides matter."""

    points: Array
    normals: Array
    tree: cKDTree


@dataclass(frozen=True)
class Quadrics:
    """Fitted at m points: normals (m, 3); curvature (m, 3, 3), K of h = n·d − ½ dᵀK d; height (m,)
    of the fit over the point; leverage (m,) of a sample at the point on that height."""

    normals: Array
    curvature: Array
    height: Array
    leverage: Array


@dataclass(frozen=True)
class Kernel:
    """width: k over the local spacing, of `neighbours` samples; deviation: standard error that it
    leaves, in the samples' units; noise: spread of the samples about their fits; exact: whether the
    samples lie on the surface, so that there is no noise to take off."""

    width: float
    neighbours: int
    deviation: float
    noise: float
    exact: bool

    @property
    def size(self) -> tuple[float, int]:
        """What `fitted` asks for."""
        return self.width, self.neighbours


def fitted(
    samples: Samples,
    x: Array,
    directions: Array,
    scale: Array,
    kernel: tuple[float, int],
    threads: int = -1,
) -> Quadrics:
    """At points x (m, 3) over planes across unit `directions` (m, 3); `scale` (m,) is the local
    spacing and `kernel` k over it with the number of neighbours."""
    size, width, count = len(x), kernel[0], min(kernel[1], len(samples.points))
    normals, curvature = np.empty((size, 3)), np.empty((size, 3, 3))
    height, leverage = np.empty(size), np.empty(size)

    def work(part: slice) -> None:
        index = nearest(samples.tree, x[part], count, 1)[1]
        offset = samples.points[index] - x[part][:, None]
        fit = _quadric(offset, samples.normals[index], directions[part], scale[part], width)
        normals[part], curvature[part], height[part], leverage[part] = fit

    in_parts(work, size, threads, min(ROWS_AT_ONCE, AT_ONCE // count))
    return Quadrics(normals, curvature, height, leverage)


def best_kernel(samples: Samples, scale: Array, threads: int = -1) -> Kernel:
    """The kernel with the least error of leave-one-out at some of the samples.

    A sample's height over the fit without it is its residual divided by 1 − H, H its own leverage.
    """
    n = len(samples.points)
    probe = np.unique(np.linspace(0, n - 1, min(n, PROBES)).astype(np.int64))
    at = samples.points[probe], samples.normals[probe], scale[probe]
    spacing = float(np.median(at[2]))
    enough, noticed = NEGLIGIBLE * spacing, NOTICED * spacing
    best: Kernel | None = None
    spreads: list[float] = []
    for width, count in KERNELS:
        if best is not None and (count > n // 4 or count * n > PAIRS or best.noise <= enough):
            break
        fit = fitted(samples, *at, (width, count), threads)
        spread = _spread(np.abs(fit.height) / np.maximum(1 - fit.leverage, 0.05))
        spreads.append(spread)
        if best is None or spread < BETTER * best.noise:
            share = float(np.median(fit.leverage))
            best = Kernel(width, count, spread * np.sqrt(share * (1 - share)), spread, exact=False)
    assert best is not None
    narrowest = best.width == KERNELS[0][0]
    return replace(best, exact=narrowest and _exact(spreads, noticed))


def _exact(spreads: list[float], noticed: float) -> bool:
    """Whether what the narrowest kernel errs by is no noise: it is small, or grows with the next
    kernel, as of bends; or there was no other."""
    return len(spreads) == 1 or spreads[0] < noticed or spreads[1] > CURVED * spreads[0]


def _spread(errors: Array) -> float:
    """Of most of the `errors`: of edges and rims, which no kernel predicts, none counts much."""
    limit = OUTLYING * float(np.median(errors))
    return float(np.sqrt((np.minimum(errors, limit) ** 2).mean()))


def _quadric(
    offset: Array, facing: Array, normal: Array, scale: Array, kernel: float
) -> tuple[Array, Array, Array, Array]:
    """Normals, curvatures, heights and leverages, from (m, k, 3) offsets of neighbours."""
    first = np.cross(normal, np.eye(3)[np.abs(normal).argmin(1)])
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(normal, first)
    frame = np.stack([first, second, normal], axis=2) / scale[:, None, None]
    u, v, z = np.moveaxis((offset @ frame).astype(np.float32), 2, 0)
    turned = 1 - np.einsum("mki,mi->mk", facing, normal).astype(np.float32)
    far = (u**2 + v**2 + np.float32(HEIGHT) * z**2) / np.float32(2 * kernel**2)
    weight = np.exp(-far - np.float32(2 / FACING**2) * turned)
    basis = np.stack([np.ones_like(u), u, v, 0.5 * u * u, u * v, 0.5 * v * v], axis=2)
    weighted = (basis * weight[:, :, None]).transpose(0, 2, 1)
    matrix = (weighted @ basis).astype(np.float64)
    ridge = RIDGE * matrix[:, 0, 0] + 1e-300
    for i, share in enumerate((1e-6, 1e-3, 1e-3, 1.0, 1.0, 1.0)):
        matrix[:, i, i] += share * ridge
    right = np.stack([(weighted @ z[:, :, None])[:, :, 0], np.tile(np.eye(6)[0], (len(u), 1))], 2)
    solved = np.linalg.solve(matrix, right)
    c = solved[:, :, 0]
    a, b = first[:, :, None], second[:, :, None]
    shape = c[:, 3, None, None] * (a * a.transpose(0, 2, 1))
    shape += c[:, 4, None, None] * (a * b.transpose(0, 2, 1) + b * a.transpose(0, 2, 1))
    shape += c[:, 5, None, None] * (b * b.transpose(0, 2, 1))
    turned_to = normal - c[:, 1:2] * first - c[:, 2:3] * second
    return (
        turned_to / np.linalg.norm(turned_to, axis=1, keepdims=True),
        shape / scale[:, None, None],
        c[:, 0] * scale,
        np.clip(solved[:, 0, 1], 0, 1),  # the sample itself has weight 1 and basis (1, 0, …)
    )
