"""What one step sees: points drawn from the pools, for the terms that are on."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from mpf_core.fit.sampler import Pools
from mpf_core.fit_options import FitOptions


@dataclass(frozen=True)
class Stage:
    """Which terms are on at one moment of the fit; `regression` is the warm start's weight.

    `terms` is False while the regression runs alone, which costs a third of a whole step.
    """

    terms: bool
    align: bool
    normal: bool
    regression: float


@dataclass(frozen=True)
class Surface:
    """Points x (n, 3): first the samples with their normals (m, 3), then those of the band, each
    with 1 in `layered` (n − m,) where align counts less at folds, else 0."""

    x: Float[Tensor, "n 3"]
    normals: Float[Tensor, "m 3"]
    layered: Float[Tensor, " k"]


@dataclass(frozen=True)
class Space:
    """Points of free space and their side, where known."""

    x: Float[Tensor, "n 3"]
    side: Float[Tensor, " n"] | None


@dataclass(frozen=True)
class Start:
    """Points and the classical start's θ and r there."""

    x: Float[Tensor, "n 3"]
    theta: Float[Tensor, " n"]
    r: Float[Tensor, " n"]


@dataclass(frozen=True)
class Batch:
    """The points of one step, by the terms that are asked for there; None where they are off."""

    surface: Surface | None = None
    far: Space | None = None
    start: Start | None = None
    ambient: Float[Tensor, "n 3"] | None = None


def draw(pools: Pools, options: FitOptions, stage: Stage, generator: torch.Generator) -> Batch:
    """A batch for the terms that are on at `stage`."""

    def pick(size: int, count: int) -> Tensor:
        return torch.randint(size, (count,), generator=generator)

    def start() -> Start:
        pool = pools.start
        assert pool is not None and pool.theta is not None and pool.r is not None
        k = pick(len(pool), options.start_points)
        return Start(pool.x[k], pool.theta[k], pool.r[k])

    if not stage.terms:
        return Batch(start=start())
    on = pick(len(pools.surface), options.surface_points)
    near = pick(len(pools.near), options.near_points)
    layered = pools.near.layered
    layered = torch.zeros(len(near)) if options.align_at_folds or layered is None else layered[near]
    x = torch.cat([pools.surface[on], pools.near.x[near]])
    surface = Surface(x, pools.normals[on], layered)
    k, side = pick(len(pools.far), options.far_points), pools.far.side
    far = Space(pools.far.x[k], None if side is None else side[k])
    targets = start() if stage.regression > 0 else None
    ambient = None
    if options.weight_lap and options.laplacian_points:
        ambient = pools.ambient.x[pick(len(pools.ambient), options.laplacian_points)]
    return Batch(surface, far, targets, ambient)
