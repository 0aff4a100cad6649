"""Noise is measured and taken off; clean clouds pass as they are."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from mpf_core.cloud.denoise import denoise
from tests.mpf_core.clouds import plane, sphere


@pytest.mark.parametrize(
    "points", [sphere(3000), plane(40), sphere(51)], ids=["sphere", "plane", "few"]
)
def test_clean_clouds_are_left_alone(points: NDArray[np.float64]) -> None:
    found = denoise(points)
    assert found.points is points
    assert found.thinned is points


@pytest.mark.parametrize("gap", [3.0, 1.5, 0.5])
def test_two_clean_sheets_are_left_alone(gap: float) -> None:
    """`gap` is in steps of the sampling."""
    sheet = plane(40)
    shift = np.array([0.01, 0.007, gap * 2 / 39])
    points = np.concatenate([sheet, sheet + shift])
    assert np.abs(denoise(points).points - points).max() < 0.2 * shift[2]


@pytest.mark.parametrize("noise", [0.04, 0.08])
def test_a_noisy_sphere_loses_most_of_its_spread(noise: float) -> None:
    points = sphere(6000, noise=noise)
    found = denoise(points)
    before = np.linalg.norm(points, axis=1).std()
    after = np.linalg.norm(found.points, axis=1)
    assert after.std() < before / 3
    assert after.mean() == pytest.approx(1, abs=0.05)  # planes cut a sphere's cap off
    assert found.points.shape == points.shape
    assert found.neighbours > 16
    # What is across the surface is measured, to the factor that weighting costs.
    assert 0.4 * noise < found.sigma < 1.5 * noise


def test_thinning_keeps_the_surface_covered() -> None:
    found = denoise(sphere(6000, noise=0.06))
    assert 500 < len(found.thinned) < 4000
    towards = sphere(200)
    gaps = np.linalg.norm(towards[:, None] - found.thinned[None], axis=2).min(axis=1)
    assert gaps.max() < 0.25


def test_a_noisy_plane_becomes_flat_without_shrinking() -> None:
    points = plane(60, jitter=0.5)
    points[:, 2] += 0.05 * np.random.default_rng(2).normal(size=len(points))
    found = denoise(points)
    inner = (np.abs(points[:, :2]) < 0.8).all(axis=1)
    assert found.points[inner, 2].std() < 0.05 / 3
    assert np.abs(found.points).max() > 0.95


def test_the_seed_decides_and_the_input_is_not_written_to() -> None:
    points = sphere(4000, noise=0.05)
    kept = points.copy()
    one, two = denoise(points, seed=3), denoise(points, seed=3)
    assert np.array_equal(points, kept)
    assert np.array_equal(one.points, two.points)
    assert np.array_equal(one.thinned, two.thinned)
