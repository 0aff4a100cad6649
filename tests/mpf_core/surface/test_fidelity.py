"""The last step: walls reach their own data, triangles stay apart, noise and gaps hold it back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mpf_core.cloud.neighbors import analyse
from mpf_core.cloud.normalize import Similarity
from mpf_core.heeding import Late
from mpf_core.options import DataOptions, SurfaceOptions
from mpf_core.quality.topology import topology
from mpf_core.surface import coarsen, fidelity, following
from mpf_core.surface.aim import Aim
from mpf_core.surface.fidelity import follow_data, onto_data
from mpf_core.surface.following import Moved
from mpf_core.surface.intersections import self_intersections
from mpf_core.surface.isosurface import Grid, extract
from mpf_core.surface.mesh import Mesh
from mpf_core.surface.normals import unit_normals

Floats = NDArray[np.float64]
Field = Callable[[Floats], Floats]
SHELL = 0.06


@dataclass(frozen=True)
class Case:
    """Samples with normals, and the zero level of a field that misses them a little."""

    points: Floats
    normals: Floats
    vertices: Floats
    faces: NDArray[np.int64]
    directions: Floats
    spacing: float

    def moved(self, *, sheet: bool = False, thickness: float = 0.0) -> Moved:
        cloud = analyse(self.points, threads=1)
        return follow_data(
            self.vertices, self.faces, self.directions, cloud, self.normals,
            np.full(len(self.points), sheet, np.int8), shell=SHELL, thickness=thickness, threads=1,
        )  # fmt: skip


def case(points: Floats, normals: Floats, field: Field, resolution: int) -> Case:
    cloud = analyse(points, threads=1)
    grid = Grid.around(points.min(0) - 0.08, points.max(0) + 0.08, resolution)
    surface = extract(
        lambda x: field(x).astype(np.float32), grid, cloud.tree, reach=cloud.median_spacing
    )
    steps = 1e-4 * np.eye(3)
    slope = [field(surface.vertices + e) - field(surface.vertices - e) for e in steps]
    directions = unit_normals(np.stack(slope, axis=1))
    return Case(points, normals, surface.vertices, surface.faces, directions, cloud.median_spacing)


def wobble(x: Floats, height: float = 2e-3) -> Floats:
    return height * np.sin(9 * x[:, 0] + 1) * np.cos(7 * x[:, 1]) * np.cos(8 * x[:, 2])


def ball(count: int = 900, *, noise: float = 0.0, half: bool = False, error: float = 2e-3) -> Case:
    rng = np.random.default_rng(3)
    normals = unit_normals(rng.normal(size=(count, 3)))
    if half:
        normals = normals[normals[:, 2] < 0]
    points = 0.6 * normals + rng.normal(scale=noise, size=normals.shape)

    def field(x: Floats) -> Floats:
        return np.linalg.norm(x, axis=1) - 0.6 + wobble(x, error)

    # The half ball's field knows the whole: the box has to hold it.
    made = case(np.concatenate([points, -points]) if half else points, normals, field, 24)
    return Case(points, normals, made.vertices, made.faces, made.directions, made.spacing)


def bent(x: Floats) -> Floats:
    return 0.12 * np.sin(3 * x[:, 0]) * np.cos(2 * x[:, 1])


def across(x: Floats) -> Floats:
    """Height over the bent sheet, along its normal up to second order."""
    a, b = 3 * x[:, 0], 2 * x[:, 1]
    slope = 0.0144 * ((3 * np.cos(a) * np.cos(b)) ** 2 + (2 * np.sin(a) * np.sin(b)) ** 2)
    return (x[:, 2] - bent(x)) / np.sqrt(1 + slope)


def shell(half_thickness: float = SHELL / 2) -> Case:
    """A closed shell whose front wall is a bent square sheet, as the fit leaves it."""
    rng = np.random.default_rng(5)
    flat = np.c_[rng.uniform(-0.5, 0.5, size=(500, 2)), np.zeros(500)]
    points = np.c_[flat[:, :2], bent(flat)]
    steps = 1e-4 * np.eye(3)
    normals = unit_normals(np.stack([across(points + e) - across(points - e) for e in steps], 1))

    def field(x: Floats) -> Floats:
        beyond = np.linalg.norm(np.maximum(np.abs(x[:, :2]) - 0.5, 0), axis=1)
        return np.hypot(across(x) + half_thickness, beyond) - half_thickness + wobble(x)

    return case(points, normals, field, 48)


def plate(thickness: float = 0.03) -> Case:
    """A solid plate thinner than the spacing of the samples on its two faces."""
    rng = np.random.default_rng(7)
    side = rng.choice([-1.0, 1.0], size=1000)
    points = np.c_[rng.uniform(-0.5, 0.5, size=(1000, 2)), side * thickness / 2]
    normals = np.c_[np.zeros((1000, 2)), side]

    def field(x: Floats) -> Floats:
        out = np.abs(x) - np.array([0.5, 0.5, thickness / 2])
        distance = np.linalg.norm(np.maximum(out, 0), axis=1) + np.minimum(out.max(1), 0)
        return distance + wobble(x)

    return case(points, normals, field, 56)


def unharmed(before: Case, after: Moved) -> None:
    """The faces are the caller's; what could be lost are embedding and area."""
    mesh = Mesh(after.vertices, before.faces)
    assert np.isfinite(after.vertices).all()
    assert topology(mesh).watertight
    assert topology(mesh).degenerate_faces == 0
    assert len(self_intersections(mesh)) == 0
    assert np.allclose(np.linalg.norm(after.normals, axis=1), 1)


def test_a_solid_reaches_its_samples() -> None:
    given = ball()
    moved = given.moved()
    unharmed(given, moved)
    before = np.abs(np.linalg.norm(given.vertices, axis=1) - 0.6).mean()
    after = np.abs(np.linalg.norm(moved.vertices, axis=1) - 0.6).mean()
    assert moved.applied
    assert moved.gain > 0.9
    assert after < 0.25 * before


def test_the_walls_of_a_shell_keep_their_sides() -> None:
    given = shell()
    moved = given.moved(sheet=True, thickness=0.01)
    unharmed(given, moved)
    inside = (np.abs(given.vertices[:, :2]) < 0.45).all(1)
    front = inside & (across(given.vertices) > -0.015)
    back = inside & (across(given.vertices) < -0.045)
    assert np.abs(across(moved.vertices[front])).mean() < 5e-4
    assert across(moved.vertices[back]).mean() == pytest.approx(-0.01, abs=5e-4)
    assert moved.thickness is not None
    median, least = moved.thickness
    assert median == pytest.approx(0.01, abs=1e-3)
    assert 0 < least <= median


def test_what_stayed_back_goes_on_in_a_second_round(monkeypatch: pytest.MonkeyPatch) -> None:
    given = shell()
    off = []
    for rounds in (1, 2):
        monkeypatch.setattr(following, "ROUNDS", rounds)
        moved = given.moved(sheet=True, thickness=0.0)  # so that the walls are in each other's way
        unharmed(given, moved)
        assert moved.taken_back > 0
        off.append(np.abs(across(moved.vertices)).mean())
    assert off[1] < 0.5 * off[0]


def test_a_second_round_that_comes_too_late_leaves_the_first(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    given, asked = shell(), []
    whole = fidelity.aim_at

    def once(*arguments: Any) -> Aim:
        asked.append(arguments)
        if len(asked) == 2:
            raise Late
        return whole(*arguments)

    monkeypatch.setattr(fidelity, "aim_at", once)
    late = given.moved(sheet=True, thickness=0.0)
    monkeypatch.setattr(following, "ROUNDS", 1)
    alone = given.moved(sheet=True, thickness=0.0)
    assert len(asked) == 3
    assert np.array_equal(late.vertices, alone.vertices)
    assert np.array_equal(late.normals, alone.normals)


def test_a_second_round_goes_no_farther_than_was_left(monkeypatch: pytest.MonkeyPatch) -> None:
    given, aims = shell(), []
    whole = fidelity.aim_at

    def astray(*arguments: Any) -> Aim:
        aim = whole(*arguments)
        aims.append(aim)
        return aim if len(aims) == 1 else replace(aim, step=aim.step + 0.05)

    monkeypatch.setattr(fidelity, "aim_at", astray)
    moved = given.moved(sheet=True, thickness=0.0)
    assert len(aims) == 2
    gone = np.linalg.norm(moved.vertices - given.vertices, axis=1)
    assert (gone <= np.linalg.norm(aims[0].step, axis=1) + 1e-4).all()


def test_the_faces_of_a_thin_plate_do_not_meet() -> None:
    given = plate()
    moved = given.moved()
    unharmed(given, moved)
    inside = (np.abs(given.vertices[:, :2]) < 0.45).all(1)
    for side in (-1, 1):
        wall = inside & (side * given.directions[:, 2] > 0.7)
        off = np.abs(moved.vertices[wall, 2] - side * 0.015)
        assert np.quantile(off, 0.99) < 5e-4
        assert off.max() < 0.005


def test_noise_leaves_a_better_field_alone() -> None:
    given = ball(noise=0.03, error=5e-4)
    moved = given.moved()
    unharmed(given, moved)
    before = np.abs(np.linalg.norm(given.vertices, axis=1) - 0.6).mean()
    after = np.abs(np.linalg.norm(moved.vertices, axis=1) - 0.6).mean()
    assert moved.bandwidth > 0.5 * given.spacing
    assert after < before + 0.005  # the samples scatter by 0.03


def test_noise_is_averaged_where_the_field_is_worse() -> None:
    given = ball(count=2000, noise=0.01, error=2e-2)
    moved = given.moved()
    unharmed(given, moved)
    before = np.abs(np.linalg.norm(given.vertices, axis=1) - 0.6).mean()
    after = np.abs(np.linalg.norm(moved.vertices, axis=1) - 0.6).mean()
    assert after < 0.6 * before


def test_vertices_far_from_data_stay() -> None:
    given = ball(half=True)
    moved = given.moved()
    unharmed(given, moved)
    far = given.vertices[:, 2] > 4 * given.spacing
    near = given.vertices[:, 2] < -0.1
    assert np.array_equal(moved.vertices[far], given.vertices[far])
    assert np.abs(np.linalg.norm(moved.vertices[near], axis=1) - 0.6).mean() < 7e-4


@pytest.mark.parametrize("switch", ["off", "auto"])
def test_off_or_without_a_local_fit_the_mesh_is_the_networks(switch: str) -> None:
    given = ball()
    mesh = Mesh(given.vertices, given.faces, given.directions)
    same, report = onto_data(
        mesh, Similarity(np.zeros(3), 1.0), None, DataOptions(fidelity=switch),
        spacing=given.spacing,
    )  # fmt: skip
    assert same is mesh
    assert report["applied"] is False
    assert report["reason"]


def test_no_mesh_that_coarsening_leaves_is_too_large_for_the_last_step() -> None:
    assert coarsen.WORTH * SurfaceOptions().coarsen_to / 2 < fidelity.MOST_VERTICES
