"""Metrics on meshes whose answer is known in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from mpf_core.errors import InputError
from mpf_core.quality.metrics import compare, evaluate, points_to_surface
from mpf_core.surface.mesh import Mesh
from tests.mpf_core.quality.meshes import box, grid_sheet, icosphere, joined, moved


def square(z: float, half: float = 1.0) -> Mesh:
    return grid_sheet(2, half=half, z=z)


def test_equal_meshes_have_distance_zero() -> None:
    result = compare(icosphere(3), icosphere(3), samples=2000)
    assert result.chamfer < 1e-9
    assert result.hausdorff < 1e-12
    assert result.f_score_005 == 1.0
    assert result.normal_consistency == pytest.approx(1.0)


def test_parallel_squares_are_their_distance_apart() -> None:
    result = compare(square(0.0075), square(0.0), samples=1000)
    assert result.chamfer == pytest.approx(7.5)
    assert result.hausdorff == pytest.approx(0.0075)
    assert result.f_score_005 == 0.0
    assert result.f_score_010 == 1.0


def test_concentric_spheres() -> None:
    result = compare(icosphere(6, radius=1.01), icosphere(6), samples=20_000)
    assert result.chamfer == pytest.approx(10.0, abs=0.02)
    assert result.normal_consistency > 0.999


def test_half_of_a_sheet_is_missing() -> None:
    # Points of the missing half lie u ∈ [0, 1] beyond the edge: mean ½ over half of the samples.
    half = square(0.0)
    kept = Mesh(half.vertices * [0.5, 1, 1] - [0.5, 0, 0], half.faces)
    result = compare(kept, half, samples=50_000)
    assert result.to_reference < 1e-9
    assert result.to_mesh == pytest.approx(250, rel=0.005)
    assert result.chamfer == pytest.approx(125, rel=0.005)
    assert result.hausdorff == pytest.approx(1.0)
    # Recall is ½ (plus the strip within 0.01 of the edge), precision 1.
    assert result.f_score_010 == pytest.approx(2 * 0.505 / 1.505, abs=1e-3)
    assert result.f_score_005 == pytest.approx(2 * 0.5025 / 1.5025, abs=1e-3)


def test_a_square_against_a_tilted_one() -> None:
    tilted = square(0.0)
    angle = np.radians(60)
    turned = tilted.vertices @ np.array(
        [[1, 0, 0], [0, np.cos(angle), np.sin(angle)], [0, -np.sin(angle), np.cos(angle)]]
    )
    result = compare(Mesh(turned, tilted.faces), tilted, samples=2000)
    assert result.normal_consistency == pytest.approx(0.5)


def test_metrics_do_not_depend_on_units_or_place() -> None:
    near = compare(icosphere(4, radius=1.02), icosphere(4), samples=5000)
    shift = np.array([4.5e5, 5.4e6, 300.0])
    far = compare(
        moved(icosphere(4, radius=1.02), 25.0, shift),
        moved(icosphere(4), 25.0, shift),
        samples=5000,
    )
    assert far.chamfer == pytest.approx(near.chamfer, rel=1e-6)
    assert far.scale == pytest.approx(25.0)


def test_same_seed_same_figures() -> None:
    first = compare(icosphere(2), icosphere(3), samples=500, seed=3)
    assert compare(icosphere(2), icosphere(3), samples=500, seed=3) == first
    assert compare(icosphere(2), icosphere(3), samples=500, seed=4) != first


def test_points_to_surface_in_units_of_the_input() -> None:
    shift = np.array([4.5e5, 5.4e6, 0.0])
    sheet = moved(square(0.0), 10.0, shift)
    heights = np.linspace(0, 1, 101)
    points = np.stack([np.zeros(101), np.zeros(101), heights], axis=1) + shift
    found = points_to_surface(points, sheet)
    assert found.mean == pytest.approx(0.5)
    assert found.median == pytest.approx(0.5)
    assert found.p95 == pytest.approx(0.95)
    assert found.max == pytest.approx(1.0)
    assert found.points == 101
    assert points_to_surface(points, sheet, at_most=40).points == 40


def test_a_mesh_without_area_is_refused() -> None:
    empty = Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int64))
    with pytest.raises(InputError):
        compare(empty, icosphere(1))
    with pytest.raises(InputError):
        compare(icosphere(1), empty)


def test_evaluation_is_one_flat_json_object() -> None:
    both = joined(box(), moved(box(), 1.0, np.array([0.6, 0.31, 0.17])))
    flat = evaluate(both, box(), samples=500).as_dict()
    assert flat["components"] == 2
    assert flat["self_intersections"] > 0
    assert flat["samples"] == 500
