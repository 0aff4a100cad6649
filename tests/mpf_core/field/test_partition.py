"""Weights that add up to one, wherever cuts are, and are smooth."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mpf_core.field.partition import Cut, Partition, smooth_ramp
from mpf_core.tiles.layout import cut_up
from tests.mpf_core.clouds import Array, ball

places = st.integers(0, 2**31 - 1)


def total(partition: Partition, x: Array) -> Array:
    sums = np.zeros(len(x))
    for share in partition.shares(x):
        assert (share.weights > 0).all()
        assert (share.weights <= 1).all()
        sums[share.rows] += share.weights
    return sums


@given(seed=places, tiles=st.integers(1, 12), spacing=st.floats(1e-4, 0.3))
def test_the_weights_of_any_cloud_add_up_to_one(seed: int, tiles: int, spacing: float) -> None:
    rng = np.random.default_rng(seed)
    partition = cut_up(ball(300, seed) * rng.uniform(0.1, 1, 3), tiles, spacing)
    assert len(partition.cuts) == tiles - 1
    x = rng.uniform(-1.5, 1.5, (500, 3))
    assert total(partition, x) == pytest.approx(1, abs=1e-12)


@given(seed=places, tiles=st.integers(2, 12))
def test_a_tile_has_weight_in_its_support_alone_and_all_of_it_within(seed: int, tiles: int) -> None:
    partition = cut_up(ball(300, seed), tiles, 0.01)
    x = np.random.default_rng(seed).uniform(-1, 1, (500, 3))
    supports = partition.boxes(np.array([[-1.0] * 3, [1.0] * 3]), 1.0)
    alone = partition.boxes(np.array([[-1.0] * 3, [1.0] * 3]), -1.0)
    shares = {share.tile: share for share in partition.shares(x)}
    for tile, (support, core) in enumerate(zip(supports, alone, strict=True)):
        weight = np.zeros(len(x))
        if tile in shares:
            weight[shares[tile].rows] = shares[tile].weights
        outside = ((x < support[0]) | (x > support[1])).any(1)
        assert not weight[outside].any()
        assert (weight[((x > core[0]) & (x < core[1])).all(1)] == 1).all()


def test_tiles_get_as_many_samples_each() -> None:
    points = ball(1000)
    partition = cut_up(points, 7, 0.01)
    low, high = partition.boxes(np.array([[-2.0] * 3, [2.0] * 3])).transpose(1, 0, 2)
    counts = [((points >= a) & (points < b)).all(1).sum() for a, b in zip(low, high, strict=True)]
    assert sum(counts) == 1000
    assert max(counts) - min(counts) <= 3


def test_the_ramp_has_two_continuous_derivatives() -> None:
    t = np.linspace(-1.5, 1.5, 3001)
    values = smooth_ramp(t)
    assert values[0] == 0
    assert values[-1] == 1
    assert smooth_ramp(-t) == pytest.approx(1 - values)
    second = np.diff(values, 2) / (t[1] - t[0]) ** 2
    assert np.abs(np.diff(second)).max() < 0.02  # a jump of the second derivative would be of 1


def test_a_single_tile_is_alone_everywhere() -> None:
    (share,) = Partition((), 1).shares(np.zeros((4, 3)))
    assert (share.tile, share.rows.tolist(), share.weights.tolist()) == (0, [0, 1, 2, 3], [1.0] * 4)


def test_no_tile_is_named_that_has_no_weight() -> None:
    partition = Partition((Cut(0, 0.0, 0.1, -1, -2),), 2)
    assert [s.tile for s in partition.shares(np.array([[-1.0, 0, 0]]))] == [0]
    assert [s.tile for s in partition.shares(np.array([[0.05, 0, 0]]))] == [0, 1]
