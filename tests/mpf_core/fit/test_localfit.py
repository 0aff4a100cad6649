"""The local fit against exact distances."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from mpf_core.cloud.neighbors import Neighborhoods, analyse
from mpf_core.fit.localfit import LocalFit
from tests.mpf_core.clouds import plane, sphere
from tests.mpf_core.fit.conftest import RADIUS

Make = Callable[[str], Neighborhoods]


def sphere_fit(count: int) -> LocalFit:
    points = sphere(count, RADIUS)
    return LocalFit(analyse(points, threads=1), points / RADIUS, threads=1)


def shell_points(
    offset: float, count: int = 500
) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    x = np.random.default_rng(4).normal(size=(count, 3))
    return x / np.linalg.norm(x, axis=1, keepdims=True) * (RADIUS + offset)


@pytest.mark.parametrize("offset", [-0.02, -0.005, 0.0, 0.005, 0.02])
def test_near_a_sphere_it_is_the_signed_distance(offset: float) -> None:
    found = sphere_fit(3000).at(shell_points(offset))
    assert found.signed == pytest.approx(offset, abs=5e-4)
    assert np.abs(found.normal - shell_points(offset) / (RADIUS + offset)).max() < 0.05
    assert np.linalg.norm(found.normal, axis=1) == pytest.approx(1)
    assert (found.beyond == 0).all()


def test_the_error_falls_with_the_square_of_the_spacing() -> None:
    errors = [np.abs(sphere_fit(count).at(shell_points(0)).signed).mean() for count in (1000, 4000)]
    assert errors[1] < errors[0] / 3


def test_on_a_plane_it_is_exact_and_the_rim_counts() -> None:
    points = plane(30)
    normals = np.broadcast_to(np.array([0.0, 0, 1]), points.shape)
    fit = LocalFit(analyse(points, threads=1), normals, threads=1)
    inside = np.array([[0.1, 0.2, 0.03], [-0.4, 0.3, -0.02]])
    found = fit.at(inside)
    assert found.signed == pytest.approx(inside[:, 2])
    assert (found.beyond == 0).all()
    outside = fit.at(np.array([[1.4, 0.0, 0.0]]))
    assert outside.beyond[0] == pytest.approx(0.4, abs=0.1)
    assert outside.nearest[0] == pytest.approx(0.4, abs=0.05)


def test_turning_the_normals_turns_the_sign(neighbours: Make) -> None:
    cloud, x = neighbours("sphere"), shell_points(0.01)
    outward = cloud.points / RADIUS
    plus, minus = (LocalFit(cloud, s * outward, threads=1).at(x) for s in (1.0, -1.0))
    assert plus.signed == pytest.approx(-minus.signed)
    assert plus.beyond == pytest.approx(minus.beyond)


def test_far_away_and_on_samples_all_is_finite(neighbours: Make) -> None:
    cloud = neighbours("hemisphere")
    fit = LocalFit(cloud, cloud.normals, threads=1)
    for x in (cloud.points[:50], np.zeros((1, 3)), np.full((1, 3), 1e3)):
        found = fit.at(x)
        for values in (found.signed, found.normal, found.beyond, found.nearest):
            assert np.isfinite(values).all()
