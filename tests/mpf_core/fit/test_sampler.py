"""The sets that the losses look at keep their definitions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor

from mpf_core.cloud.neighbors import Neighborhoods, analyse
from mpf_core.experiments.shapes import sample
from mpf_core.fit.initialize import Initialization, initialize
from mpf_core.fit.sampler import BOX, Pools, paper_pools, warm_pools
from mpf_core.fit_options import FitOptions
from tests.mpf_core.fit.conftest import RADIUS

Make = Callable[[str], Neighborhoods]
Start = Callable[[str], Initialization]
SIZE = 8000


def to_samples(cloud: Neighborhoods, x: Tensor) -> NDArray[np.float64]:
    return np.asarray(cloud.tree.query(x.numpy().astype(np.float64))[0])


def warm(
    cloud: Neighborhoods, start: Initialization, seed: int = 0, *, size: int = SIZE,
    draws: float = 1.0, normals: float = 1.0,
) -> Pools:  # fmt: skip
    options = FitOptions(rim_draws=draws, rim_normals=normals)
    return warm_pools(cloud.points, cloud, start, options, np.random.default_rng(seed), size=size)


def test_the_papers_band_and_far_set_part_at_delta(neighbours: Make) -> None:
    cloud = neighbours("sphere")
    pools = paper_pools(cloud, np.random.default_rng(0), size=SIZE, threads=1)
    assert pools.delta == pytest.approx(np.median(cloud.band_radius))
    near, far = to_samples(cloud, pools.near.x), to_samples(cloud, pools.far.x)
    rounding = 1e-6  # the pools are in single precision
    assert near.max() < pools.delta + rounding
    assert near.min() > 0
    assert far.min() > pools.delta - rounding
    assert len(near) > SIZE / 4
    assert len(far) > SIZE / 2
    assert pools.far.x.abs().max() <= BOX
    assert pools.start is None
    assert pools.near.side is None


def test_the_surface_set_is_the_cloud(neighbours: Make, start: Start) -> None:
    cloud = neighbours("sphere")
    for pools in (
        paper_pools(cloud, np.random.default_rng(0), size=100, threads=1),
        warm(cloud, start("sphere")),
    ):
        assert pools.surface.numpy() == pytest.approx(cloud.points, abs=1e-6)
        assert pools.normals.norm(dim=1).numpy() == pytest.approx(1, abs=1e-6)
        assert pools.surface.dtype == pools.normals.dtype == torch.float32


def test_with_a_warm_start_the_local_distance_parts_them(neighbours: Make, start: Start) -> None:
    cloud = neighbours("sphere")
    pools = warm(cloud, start("sphere"))
    assert pools.near.r is not None
    assert pools.far.r is not None
    assert pools.ambient.r is not None
    assert (pools.near.r < pools.delta).all()
    assert (pools.near.r > 0).all()
    assert (pools.far.r >= pools.delta).all()
    assert (pools.ambient.r >= pools.delta).all()
    exact = np.abs(np.linalg.norm(pools.near.x.numpy(), axis=1) - RADIUS)
    assert exact.max() < pools.delta + 2e-3
    # The far set reaches down to the band: uniform samples hardly ever come there.
    assert (pools.far.r < 2 * pools.delta).float().mean() > 0.1


@pytest.mark.parametrize("kind", ["sphere", "plane"])
def test_targets_belong_to_their_points(neighbours: Make, start: Start, kind: str) -> None:
    pools = warm(neighbours(kind), start(kind))
    for pool in (pools.near, pools.far, pools.start):
        assert pool is not None
        assert pool.theta is not None
        assert pool.r is not None
        assert pool.side is not None
        targets = start(kind).at(pool.x.numpy().astype(np.float64))
        assert len(pool) == len(pool.theta) == len(pool.r) == len(pool.side)
        # Points moved by rounding to single precision may change their nearest sample.
        assert np.median(np.abs(targets.r - pool.r.numpy())) < 1e-6
        assert torch.equal(pool.side, torch.sign(pool.theta))


def test_the_seed_decides(neighbours: Make, start: Start) -> None:
    cloud = neighbours("plane")
    one, same, other = (warm(cloud, start("plane"), seed) for seed in (1, 1, 2))
    assert torch.equal(one.near.x, same.near.x)
    assert torch.equal(one.far.x, same.far.x)
    assert not torch.equal(one.far.x[:50], other.far.x[:50])
    first, again = (
        paper_pools(cloud, np.random.default_rng(3), size=500, threads=1) for _ in range(2)
    )
    assert torch.equal(first.near.x, again.near.x)
    assert torch.equal(first.ambient.x, again.ambient.x)


@pytest.mark.parametrize(("shape", "least", "most"), [("plate-0.01", 0.9, 1), ("torus", 0, 0)])
def test_the_band_knows_thin_walls(shape: str, least: float, most: float) -> None:
    cloud = analyse(sample(shape, 3000, 0))
    layered = warm(cloud, initialize(cloud)).near.layered
    assert layered is not None
    assert least <= layered.mean() <= most


def test_rims_of_thin_walls_are_drawn_more_often(neighbours: Make, start: Start) -> None:
    cloud, body = neighbours("sphere"), start("sphere")
    rim = cloud.points[:, 2] > 0.4  # more than a quarter of them
    thin = replace(body)
    thin.__dict__["rims"] = rim

    def share(draws: float) -> float:
        pools = warm(cloud, thin, draws=draws)
        assert pools.start is not None
        near = pools.start.x[: int(0.6 * SIZE)].numpy().astype(np.float64)
        return float(rim[cloud.tree.query(near)[1]].mean())

    expected = rim.mean()
    assert share(1.0) == pytest.approx(expected, abs=0.02)
    assert share(4.0) == pytest.approx(4 * expected / (1 + 3 * expected), abs=0.02)
    light = warm(cloud, thin, size=100, normals=0.15)
    lengths = light.normals.norm(dim=1).numpy()
    assert lengths[rim] == pytest.approx(0.15)
    assert lengths[~rim] == pytest.approx(1)
