"""Noise is measured and taken off; clean clouds pass as they are."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from mpf_core.cloud.denoise import Smoothed, denoise, smoothed
from mpf_core.cloud.neighbors import analyse
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


@pytest.mark.parametrize("points", [sphere(3000), plane(40)], ids=["sphere", "plane"])
def test_samples_on_the_surface_stay_there(points: NDArray[np.float64]) -> None:
    neighbours = analyse(points)
    assert smoothed(points, neighbours, neighbours.normals) is None


@pytest.mark.parametrize("noise", [0.005, 0.02])
def test_quadrics_leave_a_fifth_of_the_noise_and_tell_how_much_there_was(noise: float) -> None:
    points = sphere(6000, noise=noise)
    neighbours = analyse(points)
    found = smoothed(points, neighbours, oriented(points, neighbours.normals))
    assert found is not None
    assert found.noise == pytest.approx(noise, rel=0.1)
    after = np.linalg.norm(found.points, axis=1)
    assert np.abs(after - 1).mean() < 0.2 * noise
    assert after.mean() == pytest.approx(1, abs=0.1 * noise)  # a quadric cuts no cap off


def test_quadrics_reach_the_measured_samples_past_the_planes_that_found_the_normals() -> None:
    points = sphere(6000, noise=0.05)
    cleaned = denoise(points)
    assert cleaned.points is not points
    neighbours = analyse(cleaned.thinned)
    found = smoothed(cleaned.measured, neighbours, oriented(cleaned.thinned, neighbours.normals))
    assert found is not None
    assert found.points.shape == cleaned.thinned.shape
    before = np.abs(np.linalg.norm(cleaned.thinned, axis=1) - 1).mean()
    assert np.abs(np.linalg.norm(found.points, axis=1) - 1).mean() < 0.8 * before


def test_bends_are_told_from_noise_where_the_narrowest_kernel_serves_both() -> None:
    rng = np.random.default_rng(0)
    x = rng.uniform(-1, 1, (3000, 2))
    noise = 0.002 * rng.normal(size=len(x))
    for waves, scatter in ((8, 0.0), (3, 1.0)):
        height = 0.3 / waves * np.sin(waves * np.pi * x[:, 0]) * np.cos(waves * np.pi * x[:, 1])
        points = np.column_stack([x, height + scatter * noise])
        neighbours = analyse(points)
        upwards = neighbours.normals * np.sign(neighbours.normals[:, 2:])
        found = smoothed(points, neighbours, upwards)
        if not scatter:
            assert found is None
            continue
        assert found is not None
        inner = (np.abs(x) < 0.9).all(1)
        across = (points - np.column_stack([x, height]))[inner, 2]
        moved = 0.3 / waves * np.sin(waves * np.pi * found.points[:, 0])
        moved *= np.cos(waves * np.pi * found.points[:, 1])
        assert np.abs(found.points[:, 2] - moved)[inner].mean() < 0.65 * np.abs(across).mean()


def test_folds_are_smoothed_with_the_normals_of_their_own_quadrics() -> None:
    """0.31 of the noise stays with the normals of small neighbourhoods alone."""
    found, folds = _folds(0.008)
    assert np.abs(folds).mean() < 0.26 * 0.008
    assert found.noise == pytest.approx(0.008, rel=0.1)


def test_normals_of_fits_that_follow_the_noise_are_not_taken() -> None:
    """Noise nearly as large as the spacing; with them 0.8 of it would be seen."""
    points = sphere(20_000, noise=0.03)
    cleaned = denoise(points)
    neighbours = analyse(cleaned.thinned)
    found = smoothed(cleaned.measured, neighbours, oriented(cleaned.thinned, neighbours.normals))
    assert found is not None
    assert found.noise == pytest.approx(0.03, rel=0.1)


def test_kernels_of_dense_clouds_are_as_wide_as_their_noise_asks() -> None:
    """0.10 of the noise stays with 200 neighbours, for which there are enough samples here."""
    points = sphere(20_000, noise=0.008)
    neighbours = analyse(points)
    found = smoothed(points, neighbours, oriented(points, neighbours.normals))
    assert found is not None
    assert np.abs(np.linalg.norm(found.points, axis=1) - 1).mean() < 0.085 * 0.008


def test_the_two_sides_of_a_wall_keep_apart_while_they_are_smoothed() -> None:
    sheet = plane(50)
    points = np.concatenate([sheet, sheet + np.array([0.01, 0.007, 0.15])])
    points[:, 2] += 0.01 * np.random.default_rng(0).normal(size=len(points))
    neighbours = analyse(points)
    up = np.where(points[:, 2] > 0.075, 1.0, -1.0)
    normals = neighbours.normals * np.sign(neighbours.normals[:, 2] * up)[:, None]
    found = smoothed(points, neighbours, normals)
    assert found is not None
    for side, height in ((up < 0, 0.0), (up > 0, 0.15)):
        inner = side & (np.abs(points[:, :2]) < 0.8).all(1)
        assert found.points[inner, 2].mean() == pytest.approx(height, abs=0.002)
        assert found.points[inner, 2].std() < 0.005


def _folds(noise: float) -> tuple[Smoothed, NDArray[np.float64]]:
    """A smoothed sheet of deep folds, and by how much its inner samples are off."""
    rng = np.random.default_rng(0)
    x = rng.uniform(-1, 1, (8000, 2))

    def height(x: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(0.15 * np.sin(4 * np.pi * x))

    def normal(x: NDArray[np.float64]) -> NDArray[np.float64]:
        n = np.column_stack([-0.6 * np.pi * np.cos(4 * np.pi * x), 0 * x, np.ones_like(x)])
        return np.asarray(n / np.linalg.norm(n, axis=1, keepdims=True))

    across = noise * rng.normal(size=(len(x), 1)) * normal(x[:, 0])
    points = np.column_stack([x, height(x[:, 0])]) + across
    neighbours = analyse(points)
    up = np.einsum("ni,ni->n", neighbours.normals, normal(x[:, 0]))
    found = smoothed(points, neighbours, neighbours.normals * np.sign(up)[:, None])
    assert found is not None
    inner = found.points[(np.abs(found.points[:, :2]) < 0.9).all(1)]
    return found, (inner[:, 2] - height(inner[:, 0])) * normal(inner[:, 0])[:, 2]


def oriented(points: NDArray[np.float64], normals: NDArray[np.float64]) -> NDArray[np.float64]:
    """`normals` of a ball about the origin, outwards."""
    return normals * np.sign(np.einsum("ni,ni->n", normals, points))[:, None]
