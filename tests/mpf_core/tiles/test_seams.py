"""Tiles agree where they meet: in sign, in thickness, and on a surface without a seam."""

from __future__ import annotations

import numpy as np
import pytest

from mpf_core.field.fitted import theta_of
from mpf_core.quality.meshio import read_mesh
from mpf_core.quality.sampling import sample_surface
from mpf_core.surface.cut import boundary_loops, pieces
from tests.mpf_core.clouds import Array
from tests.mpf_core.tiles.scenes import SCENES, Scene, ball, sheet


@pytest.fixture(params=list(SCENES))
def scene(request: pytest.FixtureRequest) -> Scene:
    return SCENES[request.param]()


def in_ramp(scene: Scene, x: Array) -> Array:
    """(n,) whether both tiles have weight at points x of the input's frame."""
    plan = scene.plan
    (cut,) = plan.partition.cuts
    at = plan.similarity.to_normalised(x)
    return np.asarray(np.abs(at[:, cut.axis] - cut.at) < cut.half)


def test_the_surface_is_closed_and_of_one_piece() -> None:
    surface = ball().report["surface"]
    assert surface["boundary_edges"] == surface["nonmanifold_edges"] == 0
    assert (surface["watertight"], surface["components"]) == (True, 1)
    assert surface["euler_characteristic"] == 2
    assert surface["self_intersections"] == 0
    assert ball().report["tiles"]["count"] == 2


def test_nothing_ends_and_nothing_parts_at_a_seam(scene: Scene) -> None:
    mesh = read_mesh(scene.out / "mesh.ply")
    _, piece = pieces(mesh.faces, len(mesh.vertices))
    # Where samples are: a fit as short as these errs beyond the rim of a sheet.
    low, high = scene.points.min(0), scene.points.max(0)
    there = ((mesh.vertices > low) & (mesh.vertices < high)).all(1) & in_ramp(scene, mesh.vertices)
    assert there.sum() > 200
    assert len(np.unique(piece[there])) == 1
    ends = np.concatenate([*boundary_loops(mesh.faces), np.empty(0, int)]).astype(int)
    assert not there[ends].any()


def test_the_tiles_agree_on_the_sign_at_the_seam(scene: Scene) -> None:
    rng = np.random.default_rng(0)
    points = scene.points[in_ramp(scene, scene.points)]
    away = rng.normal(size=(20, *points.shape)) * 0.15 * np.ptp(scene.points)
    x = (points + away).reshape(-1, 3)
    x = x[in_ramp(scene, x)]
    assert len(x) > 500
    values = []
    for tile in scene.tiles:
        own = tile.similarity.to_normalised(x)
        values.append(theta_of(tile.field)(own) / tile.similarity.scale)
    first, second = values
    # Where both are sure, by more than a fit of a hundred steps errs.
    sure = np.minimum(np.abs(first), np.abs(second)) > 0.05
    assert sure.sum() > 300
    assert (np.sign(first) == np.sign(second))[sure].mean() > 0.995


def test_the_error_at_the_seam_is_no_larger_than_elsewhere() -> None:
    scene = ball()
    mesh = read_mesh(scene.out / "mesh.ply")
    x = sample_surface(mesh, 20_000, np.random.default_rng(0)).points
    error = np.abs(np.linalg.norm(x - [5.0, 0, 0], axis=1) - 3)
    seam = in_ramp(scene, x)
    assert 0.02 < seam.mean() < 0.5
    assert error[seam].mean() < 1.2 * error[~seam].mean() + 1e-3
    assert error.max() < 0.1


def test_normals_go_on_across_the_seam() -> None:
    scene = ball()
    x = scene.points[in_ramp(scene, scene.points)]
    normal = scene.blend.gradient()(scene.plan.similarity.to_normalised(x)).astype(np.float64)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    assert np.einsum("ni,ni->n", normal, (x - [5.0, 0, 0]) / 3).min() > 0.9


def test_shells_have_one_thickness_on_both_sides() -> None:
    scene = sheet()
    shells = [tile.footprint.thickness for tile in scene.tiles]
    lengths = [
        thickness / tile.similarity.scale
        for thickness, tile in zip(shells, scene.tiles, strict=True)
        if thickness is not None
    ]
    assert lengths == pytest.approx([2 * scene.plan.shell] * 2)


def test_the_last_step_was_taken_over_the_seam() -> None:
    surface = ball().report["surface"]
    assert surface["fidelity"]["applied"], surface["fidelity"]
    assert surface["input_to_surface"]["p95"] < 0.02
