import numpy as np
import pytest
from numpy.typing import NDArray

from mpf_core.cloud.agreement import fitting
from mpf_core.cloud.neighbors import Neighborhoods, analyse
from tests.mpf_core.clouds import plane, sphere


def spoilt(found: Neighborhoods, rows: NDArray[np.int64]) -> NDArray[np.float64]:
    normals = found.normals.copy()
    normals[rows] = found.tangents[rows]
    return normals


@pytest.mark.parametrize("radius", [1.0, 0.2])
def test_normals_of_curved_surfaces_fit(radius: float) -> None:
    found = analyse(radius * sphere(2000))
    assert fitting(found.points, found.normals, found.links).mean() > 0.99


def test_normals_that_lie_in_the_surface_do_not_fit() -> None:
    found = analyse(plane(40))
    rows = np.arange(0, 1600, 60)
    fits = fitting(found.points, spoilt(found, rows), found.links)
    assert fits[rows].mean() < 0.1
    assert np.delete(fits, rows).mean() > 0.99


def test_orientation_does_not_matter() -> None:
    found = analyse(sphere(500))
    turned = found.normals * np.where(np.arange(500) % 3, 1.0, -1.0)[:, None]
    fits = [fitting(found.points, normals, found.links) for normals in (turned, found.normals)]
    np.testing.assert_array_equal(*fits)


def test_noise_makes_few_normals_unfit() -> None:
    rng = np.random.default_rng(0)
    found = analyse(sphere(2000) + rng.normal(size=(2000, 3)) * 0.01)
    assert fitting(found.points, found.normals, found.links).mean() > 0.8
