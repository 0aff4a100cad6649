"""Test shapes: what they are, and that samples and distances are exact."""

from __future__ import annotations

import numpy as np
import pytest

from mpf_core.errors import OptionsError
from mpf_core.experiments.build import boxes, grid, lathe, tube
from mpf_core.experiments.shapes import SHAPES, distances, sample, shape, whole
from mpf_core.quality.metrics import point_distances
from mpf_core.quality.topology import topology
from mpf_core.surface.intersections import self_intersections


@pytest.mark.parametrize("name", SHAPES)
def test_every_shape_is_normalised_and_of_its_kind(name: str) -> None:
    mesh, spec = shape(name), SHAPES[name]
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    assert np.allclose(low + high, 0, atol=1e-12)
    assert (high - low).max() == pytest.approx(2)
    counted = topology(mesh)
    assert counted.degenerate_faces == 0
    assert counted.watertight == (spec.kind == "solid")
    if spec.kind == "solid":
        assert counted.inconsistent_edges == counted.nonmanifold_vertices == 0
        corners = mesh.vertices[mesh.faces]
        volume = np.linalg.det(corners).sum() / 6
        assert volume > 0, "triangles face inwards"
    assert spec.about.endswith(".")


def test_the_whole_of_a_body_with_a_hole_is_closed_and_in_the_same_place() -> None:
    part, body = shape("holed-body"), whole("holed-body")
    counted = topology(body)
    assert counted.watertight and counted.euler_characteristic == 2
    assert counted.inconsistent_edges == counted.degenerate_faces == 0
    assert point_distances(part.vertices, body).max() < 1e-12
    base = point_distances(body.vertices, part)
    low = body.vertices[base > 1e-9]
    assert len(low) and np.all(low[:, 2] == -1)


def test_most_shapes_are_whole() -> None:
    assert whole("vase") is shape("vase")


def test_topology_of_the_paper_s_kinds() -> None:
    facts = {name: topology(shape(name)) for name in ("moebius", "vase", "dress", "lattice")}
    assert (facts["moebius"].boundary_loops, facts["moebius"].euler_characteristic) == (1, 0)
    assert facts["moebius"].inconsistent_edges > 0
    assert (facts["vase"].boundary_loops, facts["vase"].euler_characteristic) == (1, 1)
    assert (facts["dress"].boundary_loops, facts["dress"].euler_characteristic) == (2, 0)
    # 64 knots joined by 144 bars: 81 independent rings, and as many handles.
    assert facts["lattice"].euler_characteristic == 2 - 2 * 81
    assert topology(shape("t-junction")).nonmanifold_edges == 1
    assert topology(shape("x-junction")).nonmanifold_edges == 1
    assert topology(shape("nested-shells")).components == 6


@pytest.mark.parametrize("name", ["vase", "dress", "wave", "leaf", "thin-bowl"])
def test_smooth_shapes_do_not_pass_through_themselves(name: str) -> None:
    assert len(self_intersections(shape(name))) == 0


def test_distances_as_formulas_say() -> None:
    points = np.random.default_rng(1).uniform(-1.2, 1.2, size=(500, 3))
    x, y, z = points.T
    radius = np.linalg.norm(points, axis=1)
    assert np.allclose(distances("sphere", points), np.abs(radius - 1), atol=2e-4)
    ring = np.hypot(np.hypot(x, y) - 0.7, z)
    assert np.allclose(distances("torus", points), np.abs(ring - 0.3), atol=2e-4)
    beyond = np.maximum(np.abs(points[:, :2]) - 1, 0)
    assert np.allclose(distances("sheet", points), np.hypot(np.hypot(*beyond.T), z))
    thin = np.abs(points) - [1, 1, 0.005]
    inside, outside = thin.max(axis=1).clip(max=0), np.linalg.norm(thin.clip(0), axis=1)
    assert np.allclose(distances("plate-0.01", points), np.abs(inside + outside))


@pytest.mark.parametrize("name", ["cube-sheet", "flower", "ship", "lattice"])
def test_samples_lie_on_the_shape_and_repeat(name: str) -> None:
    points = sample(name, 500, seed=5)
    assert points.shape == (500, 3)
    assert distances(name, points).max() < 1e-9
    assert np.array_equal(points, sample(name, 500, seed=5))
    assert not np.array_equal(points, sample(name, 500, seed=6))


def test_what_real_clouds_have_besides() -> None:
    noisy = sample("sheet", 20_000, noise=0.005)
    assert noisy[:, 2].std() == pytest.approx(0.005, rel=0.03)
    assert len(sample("sheet", 1000, outliers=0.01)) == 1010
    uneven = sample("sheet", 20_000, uneven=4.0)[:, 0]
    assert (uneven > 0.9).sum() / (uneven < -0.9).sum() == pytest.approx(4**0.95, rel=0.2)
    walls = np.abs(sample("sheet", 1000, thickness=0.02)[:, 2])
    assert np.allclose(walls, 0.01)
    gapped, whole = sample("sheet", 4000, holes=3), sample("sheet", 4000)
    assert len(gapped) == 4000
    grid_points = np.stack(np.meshgrid(*[np.linspace(-0.9, 0.9, 40)] * 2), axis=-1).reshape(-1, 2)
    nearest = [
        np.sqrt(((grid_points[:, None] - cloud[None, :, :2]) ** 2).sum(axis=2).min(axis=1))
        for cloud in (gapped, whole)
    ]
    assert nearest[0].max() > 0.15 > nearest[1].max()


def test_unknown_shape() -> None:
    with pytest.raises(OptionsError, match="no shape 'teapot'"):
        shape("teapot")


def test_pieces() -> None:
    assert topology(boxes([(0, 2), (0, 1), (0, 1)], [(1, 3), (0, 1), (0, 1)])).watertight
    cone = lathe([(1.0, 0.0), (0.0, 1.0)])
    assert topology(cone).boundary_loops == 1
    pipe = tube(np.linspace((0, 0, 0), (0, 0, 1), 5), 0.1)
    assert (topology(pipe).boundary_loops, topology(pipe).euler_characteristic) == (1, 1)
    ring = np.zeros((6, 2, 3))
    ring[:, :, 0], ring[:, :, 1] = np.cos(np.arange(6))[:, None], np.sin(np.arange(6))[:, None]
    ring[:, 1, 2] = 1
    assert topology(grid(ring, around=True)).boundary_loops == 2


def test_both_sides_of_a_wall_are_where_its_samples_lie() -> None:
    samples = sample("wave", 2000, thickness=0.02)
    assert point_distances(samples, whole("wave", 0.02)).max() < 1e-9
    assert point_distances(samples, whole("wave")).mean() == pytest.approx(0.01, rel=0.01)
