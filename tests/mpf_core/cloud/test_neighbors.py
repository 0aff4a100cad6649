"""What the neighbours say, against surfaces that are known."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mpf_core.cloud.neighbors import (
    LINKS,
    NEAREST,
    SPACING_NEIGHBOUR,
    analyse,
    distance_within,
    median_spacing,
    nearest,
    principal_axes,
)
from tests.mpf_core.clouds import ball, plane, sphere


def angles(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Degrees between unit vectors, blind to sign."""
    cosine = np.abs(np.einsum("ni,ni->n", a, b))
    return np.asarray(np.degrees(np.arccos(np.clip(cosine, 0, 1))))


@pytest.mark.parametrize("tilt", [0.0, 0.7, 3.0])
def test_normals_of_a_plane_are_exact(tilt: float) -> None:
    found = analyse(plane(20, tilt))
    normal = np.array([-tilt, 0, 1]) / np.hypot(tilt, 1)
    assert angles(found.normals, np.broadcast_to(normal, found.normals.shape)).max() < 1e-4
    assert np.abs(found.tangents @ normal).max() < 1e-6
    assert found.flatness.max() < 1e-6
    assert found.normal_reliability == 1


def test_normals_of_a_sphere_point_along_the_radius() -> None:
    points = sphere(3000)
    found = analyse(points)
    assert angles(found.normals, points).max() < 2
    assert np.linalg.norm(found.normals, axis=1) == pytest.approx(1)
    assert np.abs(np.einsum("ni,ni->n", found.normals, found.tangents)).max() < 1e-9
    assert found.normal_reliability > 0.95


def test_noise_lowers_reliability() -> None:
    clean, rough = analyse(sphere(2000)), analyse(sphere(2000, noise=0.1))
    nothing = analyse(ball(2000))
    assert clean.normal_reliability > 0.95
    assert rough.normal_reliability < 0.8
    assert nothing.normal_reliability < 0.5


def test_rim_points_out_of_a_half_plane() -> None:
    points = plane(30)
    found = analyse(points)
    x, y = points[:, 0], points[:, 1]
    edge = (x > 0.98) & (np.abs(y) < 0.8)
    inner = (np.abs(x) < 0.8) & (np.abs(y) < 0.8)
    has_rim = found.rim.any(axis=1)
    assert has_rim[edge].mean() > 0.9
    assert (found.rim[edge & has_rim] @ [1.0, 0, 0]).mean() > 0.9
    assert has_rim[inner].mean() < 0.02
    assert np.linalg.norm(found.rim[has_rim], axis=1) == pytest.approx(1)
    assert np.abs(np.einsum("ni,ni->n", found.rim, found.normals)).max() < 1e-9


def test_a_closed_surface_has_no_rim() -> None:
    assert not analyse(sphere(2000)).rim.any()


def test_spacing_follows_the_density() -> None:
    coarse, fine = analyse(sphere(1000)), analyse(sphere(4000))
    assert coarse.median_spacing / fine.median_spacing == pytest.approx(2, rel=0.1)
    # A regular triangular lattice on area A / n has its 6th neighbour at √(2A / (√3 n)).
    lattice = np.sqrt(2 * 4 * np.pi / (np.sqrt(3) * 4000))
    assert fine.median_spacing == pytest.approx(lattice, rel=0.3)
    assert (fine.spacing <= fine.disc_radius).all()
    assert (fine.disc_radius <= fine.band_radius).all()
    for cloud in (coarse, fine):  # of evenly scattered samples the sixth disc is a little too large
        assert cloud.areas.sum() == pytest.approx(4 * np.pi, rel=0.15)


def test_distances_and_links_are_those_of_brute_force() -> None:
    points = np.random.default_rng(1).uniform(-1, 1, size=(200, 3))
    found = analyse(points)
    all_distances = np.linalg.norm(points[:, None] - points[None], axis=2)
    ordered = np.sort(all_distances, axis=1)
    assert found.spacing == pytest.approx(ordered[:, SPACING_NEIGHBOUR])
    assert found.band_radius == pytest.approx(ordered[:, NEAREST])
    assert np.array_equal(found.links, np.argsort(all_distances, axis=1)[:, 1 : LINKS + 1])
    assert median_spacing(found.tree) == pytest.approx(found.median_spacing)


def test_the_fewest_points_are_enough() -> None:
    found = analyse(sphere(NEAREST + 1))
    for values in (found.normals, found.spacing, found.band_radius, found.flatness, found.rim):
        assert np.isfinite(values).all()


def test_coinciding_points_do_not_break_the_axes() -> None:
    values, vectors = principal_axes(np.zeros((1, 16, 3)), np.zeros((1, 16)))
    assert np.isfinite(values).all()
    assert np.isfinite(vectors).all()


def test_queries_keep_their_shape_for_one_neighbour_and_beyond_the_bound() -> None:
    tree = cKDTree(np.eye(3))
    distance, index = nearest(tree, np.zeros((2, 3)), 1, 1)
    assert distance.shape == index.shape == (2, 1)
    assert np.isinf(distance_within(tree, np.zeros((1, 3)), 0.5)).all()
    assert distance_within(tree, np.zeros((1, 3)), 2.0) == pytest.approx(1)
