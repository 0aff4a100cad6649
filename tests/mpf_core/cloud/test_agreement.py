import numpy as np
import pytest
from numpy.typing import NDArray

from mpf_core.cloud.agreement import Agreement, agreed
from mpf_core.cloud.neighbors import Neighborhoods, analyse
from tests.mpf_core.clouds import plane, sampled, sphere


def spoilt(found: Neighborhoods, rows: NDArray[np.int64]) -> NDArray[np.float64]:
    normals = found.normals.copy()
    normals[rows] = found.tangents[rows]
    return normals


def asked(
    found: Neighborhoods, normals: NDArray[np.float64], fixed: NDArray[np.bool_] | bool = False
) -> Agreement:
    """Those around, about `normals` in the place of their own."""
    fixed = np.broadcast_to(fixed, len(normals))
    return agreed(found.points, normals, found.links, found.tree, fixed=fixed)


def fitting(found: Neighborhoods, normals: NDArray[np.float64]) -> NDArray[np.bool_]:
    return asked(found, normals, fixed=True).sure


@pytest.mark.parametrize("radius", [1.0, 0.2])
def test_normals_of_curved_surfaces_fit(radius: float) -> None:
    found = analyse(radius * sphere(2000))
    assert fitting(found, found.normals).mean() > 0.99


def test_normals_that_lie_in_the_surface_do_not_fit() -> None:
    found = analyse(plane(40))
    rows = np.arange(0, 1600, 60)
    fits = fitting(found, spoilt(found, rows))
    assert fits[rows].mean() < 0.1
    assert np.delete(fits, rows).mean() > 0.99


def test_orientation_does_not_matter() -> None:
    found = analyse(sphere(500))
    turned = found.normals * np.where(np.arange(500) % 3, 1.0, -1.0)[:, None]
    fits = [fitting(found, normals) for normals in (turned, found.normals)]
    np.testing.assert_array_equal(*fits)


def test_noise_makes_few_normals_unfit() -> None:
    rng = np.random.default_rng(0)
    found = analyse(sphere(2000) + rng.normal(size=(2000, 3)) * 0.01)
    assert fitting(found, found.normals).mean() > 0.8


def test_contradicted_normals_are_those_of_the_one_plane_around() -> None:
    found = analyse(plane(40))
    rows = np.arange(0, 1600, 60)
    told = asked(found, spoilt(found, rows))
    assert told.sure[rows].all()
    np.testing.assert_allclose(np.abs((told.normals * found.normals).sum(1)), 1, atol=1e-9)


def test_fixed_normals_stay_and_are_not_sure() -> None:
    found = analyse(plane(40))
    rows = np.arange(0, 1600, 60)
    before = spoilt(found, rows)
    told = asked(found, before, fixed=np.isin(np.arange(1600), rows))
    np.testing.assert_array_equal(told.normals, before)
    assert told.sure[rows].mean() < 0.1


def test_a_noisy_cloud_is_left_as_it_is() -> None:
    rng = np.random.default_rng(0)
    found = analyse(sphere(2000) + rng.normal(size=(2000, 3)) * 0.02)
    rows = np.arange(0, 2000, 60)
    before = spoilt(found, rows)
    told = asked(found, before)
    np.testing.assert_array_equal(told.normals, before)


def test_the_rim_of_a_thin_plate_is_told_by_its_neighbours() -> None:
    """A rim less than two gaps between samples wide, of which no patch shows the plane."""
    points, exact = sampled("plate-0.05", 10_000)
    rim = (np.abs(exact[:, 2]) < 0.5) & (np.abs(points[:, 2]) < 0.02)
    found = analyse(points, threads=1)
    cosine = np.abs(np.einsum("ni,ni->n", found.normals, exact))[rim]
    assert (cosine > np.cos(np.radians(5))).mean() > 0.8  # 0.67 by their own patches
    assert found.consistent[rim].mean() > 0.75  # 0.5
