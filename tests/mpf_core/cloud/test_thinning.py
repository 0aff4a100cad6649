"""Thinning keeps samples, evenly, and leaves small clouds alone."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from mpf_core.cloud.thinning import one_of_each_voxel
from tests.mpf_core.clouds import sphere


def test_few_points_are_left_alone() -> None:
    index, pitch = one_of_each_voxel(sphere(100), 100)
    assert np.array_equal(index, np.arange(100))
    assert pitch == 0


@given(most=st.integers(60, 900), seed=st.integers(0, 99))
def test_what_is_kept_was_there_once_and_is_not_more_than_asked(most: int, seed: int) -> None:
    points = np.random.default_rng(seed).normal(size=(1000, 3)) * [1, 1, 0.01]
    index, pitch = one_of_each_voxel(points, most)
    assert 0.3 * most < len(index) <= most
    assert (np.diff(index) > 0).all()
    cells = np.floor((points - points.min(0)) / pitch)
    assert len(np.unique(cells[index], axis=0)) == len(np.unique(cells, axis=0)) == len(index)


def test_a_dense_spot_far_from_all_else_is_not_lost() -> None:
    spot = np.concatenate([sphere(5000, 0.01), [[1.0, 1, 1], [-1, -1, -1]]])
    assert len(one_of_each_voxel(spot, 1000)[0]) > 300


def test_an_uneven_cloud_becomes_even_and_covers_the_surface() -> None:
    points = sphere(20_000)
    rng = np.random.default_rng(0)
    uneven = points[rng.random(len(points)) < 10 ** (-1.5 * (points[:, 0] + 1) / 2)]
    kept = uneven[one_of_each_voxel(uneven, 1000)[0]]
    gaps = cKDTree(kept).query(uneven)[0]
    assert gaps.max() < 0.3
    assert ((kept[:, 0] > 0).sum() / len(kept)) > 2 * (uneven[:, 0] > 0).mean()
