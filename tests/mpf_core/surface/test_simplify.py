"""Decimation and smoothing: how much is left, how far it moved, what stays whole."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from mpf_core.errors import SurfaceError
from mpf_core.quality.topology import topology
from mpf_core.surface.cut import clip
from mpf_core.surface.mesh import Mesh
from mpf_core.surface.simplify import decimated, deviation, taubin

BALL = trimesh.creation.icosphere(subdivisions=4)
VERTICES, FACES = np.array(BALL.vertices), np.array(BALL.faces, dtype=np.int64)
UTM = np.array([448_262.125, 5_411_932.5, 312.0])


@pytest.mark.parametrize("shift", [0 * UTM, UTM], ids=["origin", "utm"])
@pytest.mark.parametrize("target", [200, 1000, 4000])
def test_decimation_keeps_a_ball_a_ball(target: int, shift: np.ndarray) -> None:
    vertices, faces = decimated(VERTICES + shift, FACES, target)
    counts = topology(Mesh(vertices, faces))
    assert 0.9 * target <= len(faces) <= 1.02 * target + 4
    assert counts.watertight
    assert (counts.euler_characteristic, counts.nonmanifold_edges) == (2, 0)
    moved = deviation((VERTICES + shift, FACES), (vertices, faces))
    # The sagitta of a triangle of the area that is left to each.
    sagitta = 4 * np.pi / target / np.sqrt(3) / 3
    assert 0 < moved.mean < sagitta
    assert moved.mean < moved.largest < 5 * sagitta


def test_few_enough_faces_are_left_alone() -> None:
    vertices, faces = decimated(VERTICES, FACES, len(FACES))
    assert vertices is VERTICES
    assert faces is FACES


def test_an_open_surface_stays_open_along_one_curve() -> None:
    vertices, faces, _ = clip(VERTICES, FACES, VERTICES[:, 2] - 0.3)
    fewer = decimated(vertices, faces, 400)
    counts = topology(Mesh(*fewer))
    assert (counts.components, counts.boundary_loops, counts.nonmanifold_edges) == (1, 1, 0)


def test_what_cannot_be_had_whole_is_refused() -> None:
    balls = [VERTICES + np.array([3 * k, 0, 0]) for k in range(40)]
    faces = np.concatenate([FACES + k * len(VERTICES) for k in range(40)])
    with pytest.raises(SurfaceError) as told:
        decimated(np.concatenate(balls), faces, 100)  # 40 closed pieces need 160
    assert told.value.where == "max_faces"


def test_the_distance_of_two_spheres_is_that_of_their_radii() -> None:
    found = deviation((VERTICES + UTM, FACES), (1.1 * VERTICES + UTM, FACES))
    assert found.mean == pytest.approx(0.1, rel=0.02)
    assert found.largest == pytest.approx(0.1, rel=0.02)
    assert found.points > 2000


def test_smoothing_takes_noise_and_leaves_the_size() -> None:
    rough = VERTICES + np.random.default_rng(0).normal(scale=0.004, size=VERTICES.shape)
    radii = np.linalg.norm(taubin(rough, FACES, 15), axis=1)
    assert radii.std() < 0.4 * np.linalg.norm(rough, axis=1).std()
    assert radii.mean() == pytest.approx(1, abs=0.002)


def test_smoothing_leaves_the_curve_of_a_boundary_in_place() -> None:
    vertices, faces, _ = clip(VERTICES, FACES, VERTICES[:, 2] - 0.3)
    smooth = taubin(vertices, faces, 30)
    assert np.linalg.norm(smooth, axis=1) == pytest.approx(1, abs=0.01)
    assert smooth[:, 2].min() == pytest.approx(0.3, abs=0.02)
