"""The warm start's targets against exact distances of solids and thin shells."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from mpf_core.cloud.neighbors import analyse
from mpf_core.experiments.shapes import sample
from mpf_core.fit.initialize import SHELL, THICKEST, Initialization, half_thickness, initialize
from tests.mpf_core.cloud.test_rods import rod
from tests.mpf_core.fit.conftest import RADIUS

Start = Callable[[str], Initialization]


def uniform(count: int = 4000) -> NDArray[np.float64]:
    return np.random.default_rng(5).uniform(-1.1, 1.1, size=(count, 3))


def test_targets_of_a_sphere_are_its_distance(start: Start) -> None:
    x = uniform()
    exact = np.linalg.norm(x, axis=1) - RADIUS
    targets = start("sphere").at(x)
    spacing = start("sphere").local.neighbours.median_spacing
    # Far away the nearest sample stands in for the surface, less the shell.
    assert np.abs(targets.theta - exact).max() < 0.5 * spacing + SHELL
    assert np.abs(targets.r - np.abs(exact)).max() < 0.5 * spacing
    near = np.abs(exact) < 0.02
    assert np.abs(targets.r - np.abs(exact))[near].max() < 1e-3
    assert (targets.r >= 0).all()
    off = np.abs(exact) > 2 * SHELL
    assert (np.sign(targets.theta) == np.sign(exact))[off].all()


def test_sides_are_known_away_from_the_samples(start: Start) -> None:
    x = uniform()
    exact = np.linalg.norm(x, axis=1) - RADIUS
    side = start("sphere").at(x).side
    assert set(np.unique(side)) <= {-1.0, 0.0, 1.0}
    off = np.abs(exact) > 0.2
    assert (side[off] == np.sign(exact[off])).all()


def test_shells_are_thicker_where_samples_are_sparse_and_where_the_area_is_large(
    start: Start,
) -> None:
    cloud = start("plane").local.neighbours

    def thickness(spacing: float, count: int) -> float:
        return half_thickness(replace(cloud, spacing=np.full(count, spacing)))

    assert thickness(0.01, 10_000) == SHELL
    assert thickness(0.025, 3_000) == pytest.approx(0.0075)
    assert thickness(0.06, 3_000) == THICKEST
    assert SHELL < thickness(0.018, 60_000) < thickness(0.018, 75_000) < THICKEST


def test_a_sheet_becomes_a_closed_shell_through_the_samples(start: Start) -> None:
    plate = start("plane")
    points, normals = plate.local.neighbours.points, plate.normals
    inner = (np.abs(points[:, :2]) < 0.7).all(axis=1)
    at = points[inner]
    for depth, theta in (
        (0.0, 0.0),
        (plate.shell, -plate.shell),
        (2 * plate.shell, 0.0),
        (0.5 * plate.shell, -0.5 * plate.shell),
    ):
        found = plate.at(at - depth * normals[inner])
        assert found.theta == pytest.approx(theta, abs=2e-4)
        assert found.r == pytest.approx(depth, abs=2e-4)
    above = plate.at(at + 0.02 * normals[inner])
    assert above.theta == pytest.approx(0.02, abs=5e-4)


def test_beyond_the_rim_a_sheet_is_over(start: Start) -> None:
    out = np.array([[1.05, 0.0, 0.21], [0.0, -1.05, 0.0], [1.0, 1.0, 0.2]])
    targets = start("plane").at(out)
    assert (targets.theta > 0.05).all()
    assert (targets.r > 0.05).all()


def test_an_open_bowl_holds_nothing(start: Start) -> None:
    bowl = start("hemisphere")
    x = np.array([[0.0, 0.0, 0.3], [0.2, 0.1, 0.5], [0.0, 0.0, -0.5]])
    targets = bowl.at(x)
    assert (targets.theta > 0).all()
    assert (targets.side == 1).all()


def test_normals_at_samples_are_those_of_the_start(start: Start) -> None:
    sphere = start("sphere")
    points = sphere.local.neighbours.points
    np.testing.assert_array_equal(sphere.normals_at(points), sphere.normals)
    moved = sphere.normals_at(points * 1.001)
    assert np.einsum("ni,ni->n", moved, points / RADIUS).min() > 0.99


@pytest.mark.parametrize("moved", [1.0, 1.0001])
def test_normals_that_the_samples_around_contradict_are_not_handed_on(
    start: Start, moved: float
) -> None:
    sphere = start("sphere")
    near = sphere.local.neighbours
    doubted = replace(near, consistent=np.arange(len(near.points)) != 7)
    spoilt = replace(sphere, local=replace(sphere.local, neighbours=doubted))
    x = near.points if moved == 1.0 else near.points * moved
    length = np.linalg.norm(spoilt.normals_at(x), axis=1)
    assert length[7] == 0
    np.testing.assert_allclose(np.delete(length, 7), 1.0, atol=1e-6)


@pytest.mark.parametrize(("thickness", "least"), [(0.01, 0.7), (0.05, 0.25)])
def test_rims_of_a_thin_plate_lie_along_its_sides(thickness: float, least: float) -> None:
    """`least` of the samples within a quarter of a spacing of the sides, few farther than two."""
    plate = initialize(analyse(sample(f"plate-{thickness:g}", 4000, 0)))
    cloud = plate.local.neighbours
    flat = np.sort(np.abs(cloud.points), axis=1)[:, 2]  # 1 on the sides
    inwards = (1 - flat) / cloud.median_spacing
    assert (inwards[plate.rims] < 2).mean() > 0.9
    assert plate.rims[inwards < 0.25].mean() > least
    lengths = np.linalg.norm(plate.normals_at(cloud.points, at_rims=0.15), axis=1)
    assert lengths[plate.rims].max() == pytest.approx(0.15)
    others = lengths[~plate.rims]
    assert (np.isclose(others, 1) | (others == 0)).all()


def test_edges_of_a_thick_body_and_rims_of_sheets_are_none(start: Start) -> None:
    """A cube of 4000 samples has none either: its faces do not need to turn within a spacing."""
    assert not start("sphere").rims.any()
    assert not start("plane").rims.any()
    assert initialize(analyse(sample("cube-sheet", 4000, 0))).rims.mean() < 0.01


def test_rods_have_no_rims() -> None:
    """Their normals turn within a spacing everywhere, but nothing ends there."""
    points, *_ = rod(0.02, 700)
    cloud = analyse(points)
    assert cloud.rods.mean() > 0.9
    assert initialize(cloud).rims.mean() < 0.05
