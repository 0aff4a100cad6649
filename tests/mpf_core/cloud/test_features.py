"""Normals beside sharp edges, on shapes whose normals are known."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from mpf_core.cloud.features import sharpened
from mpf_core.cloud.neighbors import analyse
from mpf_core.fit.initialize import initialize
from tests.mpf_core.clouds import sampled

Array = NDArray[np.float64]


def wrong(found: Array, exact: Array) -> float:
    """Share of normals more than 20° off."""
    cosine = np.abs(np.einsum("ni,ni->n", found, exact))
    return float((cosine < np.cos(np.radians(20))).mean())


@pytest.mark.parametrize("name", ["plate-0.1", "cube-sheet"])
def test_normals_beside_edges_are_those_of_the_faces(name: str) -> None:
    points, exact = sampled(name, 8000)
    assert wrong(analyse(points, threads=1).normals, exact) < 0.03


def test_a_rim_three_spacings_wide_is_a_face() -> None:
    """No patch lies on it alone: the planes through pairs of neighbours find it."""
    points, exact = sampled("plate-0.1", 10_000)
    rim = (np.abs(exact[:, 2]) < 0.5) & (np.abs(points[:, 2]) < 0.035)
    found = analyse(points, threads=1).normals
    assert wrong(found[rim], exact[rim]) < 0.03


def test_smooth_shapes_keep_theirs() -> None:
    points, exact = sampled("torus", 5000)
    assert wrong(analyse(points, threads=1).normals, exact) < 0.001


def test_noise_is_not_taken_for_edges() -> None:
    points, _ = sampled("sphere", 4000, noise=0.01)
    cloud = analyse(points, threads=1)
    again = sharpened(
        cloud.points, cloud.normals, cloud.spacing, cloud.flatness, cloud.tree,
        fixed=np.zeros(len(points), dtype=bool), threads=1,
    )  # fmt: skip
    exact = points / np.linalg.norm(points, axis=1, keepdims=True)
    assert wrong(again, exact) < 0.1


def test_those_to_leave_alone_are_left_alone() -> None:
    points, _ = sampled("plate-0.1", 2000)
    cloud = analyse(points, threads=1)
    rng = np.random.default_rng(0)
    blurred = cloud.normals + 0.5 * rng.normal(size=points.shape)
    blurred /= np.linalg.norm(blurred, axis=1, keepdims=True)
    fixed = rng.random(len(points)) < 0.5
    bent = np.ones(len(points))
    found = sharpened(points, blurred, cloud.spacing, bent, cloud.tree, fixed=fixed, threads=1)
    assert np.array_equal(found[fixed], blurred[fixed])
    assert not np.array_equal(found[~fixed], blurred[~fixed])


def test_the_start_has_sharp_edges() -> None:
    """θ* just outside and just inside the edges of a plate 0.1 thick."""
    points, _ = sampled("plate-0.1", 8000)
    start = initialize(analyse(points, threads=1), threads=1)
    along = np.linspace(-0.8, 0.8, 200)
    corner = np.stack([along, np.full(200, 1.0), np.full(200, 0.05)], axis=1)
    inward = np.array([0.0, -1.0, -1.0]) / np.sqrt(2)
    outside, inside = (
        start.at(corner - 0.015 * inward).theta,
        start.at(corner + 0.02 * inward).theta,
    )
    assert (outside > 0).mean() > 0.97
    assert (inside < 0).mean() > 0.97
    # With the normals of PCA it was 0.008.
    assert np.abs(np.median(start.at(corner).theta)) < 0.005
