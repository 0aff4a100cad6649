"""Where the losses look: surface, band and far samples, drawn from pools that are made once.

The paper's sets (section Experiments, Implementation details): band N_δ, the samples jittered by a
Gaussian whose width is the distance to the 50th neighbour, kept where 0 < d < δ; far, uniform in
the box, kept where d ≥ δ; d is the distance to the nearest sample.

With a warm start the distance to the local fit takes the place of d. It resolves the band below
the spacing of the samples, and half of the far samples lie close outside the band: so the far-field
terms reach down to the wall of a shell, where uniform samples never come.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor

from mpf_core.cloud.neighbors import CHUNK, Neighborhoods, distance_within
from mpf_core.fit.initialize import Initialization, Targets
from mpf_core.fit_options import FitOptions
from mpf_core.parallel import shared

BOX = 1.1  # Ω = [-BOX, BOX]³
POOL = 400_000  # seen some twenty times each in a balanced fit
BAND_SPACINGS = 0.25  # δ in local-fit distance, over the median spacing
BAND_SHELLS = 3.0  # and at least this many half thicknesses of the shell

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True)
class Pool:
    """Points with what the losses need to know about them.

    x: (n, 3); side: (n,) +1 outside, −1 enclosed; theta, r: (n,) the classical start; layered: (n,)
    1 where the nearest sample is of a thin wall or rod, else 0. Without a warm start only x.
    """

    x: Float[Tensor, "n 3"]
    side: Float[Tensor, " n"] | None = None
    theta: Float[Tensor, " n"] | None = None
    r: Float[Tensor, " n"] | None = None
    layered: Float[Tensor, " n"] | None = None

    def __len__(self) -> int:
        return len(self.x)


@dataclass(frozen=True)
class Pools:
    """All that the loop draws from.

    surface: (n, 3) the cloud with `normals`, whose lengths are their weights; near: N_δ; far:
    Ω \\ N_δ; ambient: uniform in free space, for second derivatives; start: for the regression;
    delta: δ, and spacing: the median distance of a sample to its sixth neighbour, normalised.
    """

    surface: Float[Tensor, "n 3"]
    normals: Float[Tensor, "n 3"]
    near: Pool
    far: Pool
    ambient: Pool
    start: Pool | None
    delta: float
    spacing: float


def pool_size(options: FitOptions) -> int:
    """So many that a point is seen a few times in a fit, at most POOL; short fits need fewer."""
    drawn = options.max_iterations * max(options.start_points, options.near_points)
    return min(POOL, max(20_000, drawn // 2))


def paper_pools(
    neighbours: Neighborhoods, rng: np.random.Generator, *, size: int = POOL, threads: int = -1
) -> Pools:
    """The sets of the paper for a cloud in [-1, 1]³; δ is the median distance to the 50th
    neighbour, which the paper leaves open."""
    delta = float(np.median(neighbours.band_radius))

    def distance(x: Array) -> Array:
        return distance_within(neighbours.tree, x, delta, threads)

    pick = rng.integers(len(neighbours.points), size=size)
    near = _jittered(neighbours, neighbours.band_radius, pick, rng)
    to_cloud = distance(near)
    near = near[(to_cloud > 0) & (to_cloud < delta)]
    far = _uniform(size, rng)
    far = far[distance(far) >= delta]
    return Pools(
        surface=_tensor(neighbours.points),
        normals=_tensor(neighbours.normals),
        near=Pool(_tensor(near)),
        far=Pool(_tensor(far)),
        ambient=Pool(_tensor(_uniform(size, rng))),
        start=None,
        delta=delta,
        spacing=neighbours.median_spacing,
    )


def warm_pools(
    samples: Array,
    neighbours: Neighborhoods,
    initialization: Initialization,
    options: FitOptions,
    rng: np.random.Generator,
    *,
    size: int | None = None,
) -> Pools:
    """The sets with a warm start: one pool with targets, parted at δ.

    samples: (n, 3) where the surface terms are asked for; `neighbours` may be of a thinned cloud.
    size: `pool_size` if not given.
    """
    draws = np.where(initialization.rims, options.rim_draws, 1.0)
    chances = None if (draws == 1).all() else draws / draws.sum()

    def pick(count: int) -> Indices:
        if chances is None:
            return rng.integers(len(draws), size=count)
        return rng.choice(len(draws), size=count, p=chances)

    delta = max(BAND_SPACINGS * neighbours.median_spacing, BAND_SHELLS * initialization.shell)
    size = pool_size(options) if size is None else size
    parts = [int(size * share) for share in (0.30, 0.30, 0.20, 0.20)]
    x = np.concatenate(
        [
            _across_shell(neighbours, initialization, pick(parts[0]), rng),
            _jittered(neighbours, 0.5 * neighbours.spacing, pick(parts[1]), rng),
            _jittered(neighbours, neighbours.band_radius, pick(parts[2]), rng),
            _uniform(parts[3], rng),
        ]
    )

    def part(rows: slice) -> list[Targets]:
        starts = range(rows.start, rows.stop, CHUNK)
        return [initialization.at(x[i : min(i + CHUNK, rows.stop)]) for i in starts]

    targets = [one for some in shared(part, len(x)) for one in some]
    start = Pool(
        _tensor(x),
        _tensor(np.concatenate([np.sign(t.theta) for t in targets])),
        _tensor(np.concatenate([t.theta for t in targets])),
        _tensor(np.concatenate([t.r for t in targets])),
        _tensor(np.concatenate([t.layered for t in targets])),
    )
    assert start.r is not None and start.side is not None
    outside_band = start.r >= delta
    uniform = torch.arange(len(x)) >= len(x) - parts[3]
    return Pools(
        surface=_tensor(samples),
        normals=_tensor(initialization.normals_at(samples, options.rim_normals)),
        near=_where(start, ~outside_band & (start.r > 0)),
        far=_where(start, outside_band),
        ambient=_where(start, outside_band & uniform),
        start=start,
        delta=delta,
        spacing=neighbours.median_spacing,
    )


def _tensor(values: NDArray[np.generic]) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(values, dtype=np.float32))


def _where(pool: Pool, mask: Tensor) -> Pool:
    assert pool.side is not None and pool.theta is not None and pool.r is not None
    assert pool.layered is not None
    return Pool(pool.x[mask], pool.side[mask], pool.theta[mask], pool.r[mask], pool.layered[mask])


def _uniform(count: int, rng: np.random.Generator) -> Array:
    return rng.uniform(-BOX, BOX, size=(count, 3))


def _jittered(
    neighbours: Neighborhoods, width: Array, pick: Indices, rng: np.random.Generator
) -> Array:
    return neighbours.points[pick] + rng.normal(size=(len(pick), 3)) * width[pick, None]


def _across_shell(
    neighbours: Neighborhoods, start: Initialization, pick: Indices, rng: np.random.Generator
) -> Array:
    """Spread in the tangent plane, and along the normal across both walls of the shell."""
    count = len(pick)
    normals = start.normals[pick]
    lateral = rng.normal(size=(count, 3)) * 0.5 * neighbours.spacing[pick, None]
    lateral -= np.einsum("ni,ni->n", lateral, normals)[:, None] * normals
    depth = rng.normal(size=(count, 1)) * 1.6 * start.shell - start.shell
    return neighbours.points[pick] + lateral + depth * normals
