"""Cutting and closing meshes: what is left, what it is bounded by, which way it turns."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from mpf_core.quality.topology import topology
from mpf_core.surface import cut
from mpf_core.surface.mesh import Mesh
from mpf_core.surface.normals import enclosed_volume, face_areas

BALL = trimesh.creation.icosphere(subdivisions=3)
VERTICES, FACES = np.array(BALL.vertices), np.array(BALL.faces, dtype=np.int64)


def above(height: float) -> tuple[Any, Any, Any]:
    return cut.clip(VERTICES, FACES, VERTICES[:, 2] - height)


@pytest.mark.parametrize("height", [-0.93, -0.4, 0.013, 0.5])
def test_a_cap_is_cut_off_along_one_circle(height: float) -> None:
    vertices, faces, origin = above(height)
    counts = topology(Mesh(vertices, faces))
    assert (counts.components, counts.boundary_loops, counts.euler_characteristic) == (1, 1, 1)
    assert counts.nonmanifold_edges == counts.inconsistent_edges == counts.degenerate_faces == 0
    edge = 0.16  # the longest of the ball, a tenth of which a cut may be off
    (loop,) = cut.boundary_loops(faces)
    assert np.abs(vertices[loop, 2] - height).max() < 0.1 * edge
    area = face_areas(Mesh(vertices, faces)).sum()
    assert area == pytest.approx(2 * np.pi * (1 - height), abs=0.05 * edge * 2 * np.pi + 0.08)
    assert np.abs(vertices - VERTICES[origin]).max() < edge


def test_nothing_and_everything() -> None:
    vertices, faces, _ = above(2.0)
    assert len(vertices) == len(faces) == 0
    vertices, faces, _ = above(-2.0)
    assert np.array_equal(vertices, VERTICES)
    assert np.array_equal(faces, FACES)


@settings(deadline=None, max_examples=25)
@given(st.lists(st.floats(-1, 1), min_size=3, max_size=3), st.floats(-0.9, 0.9))
def test_the_two_parts_of_a_cut_make_up_the_whole(direction: list[float], height: float) -> None:
    value = VERTICES @ np.array(direction) - height
    value[value == 0] = 1e-9
    parts = [cut.clip(VERTICES, FACES, side * value) for side in (1, -1)]
    areas = [face_areas(Mesh(*part[:2])).sum() for part in parts]
    assert sum(areas) == pytest.approx(face_areas(Mesh(VERTICES, FACES)).sum(), rel=0.02)


@pytest.mark.parametrize("height", [-0.4, 0.5, 0.9])
def test_a_filled_hole_closes_the_mesh_and_keeps_its_outside_out(height: float) -> None:
    vertices, faces, _ = above(height)
    loops = cut.boundary_loops(faces)
    closed = Mesh(*cut.filled(vertices, faces, loops))
    counts = topology(closed)
    assert counts.watertight
    assert (counts.euler_characteristic, counts.inconsistent_edges) == (2, 0)
    assert len(closed.faces) == len(faces) + len(loops[0]) - 2
    cap = np.pi * (1 - height) ** 2 * (2 + height) / 3
    assert enclosed_volume(closed) == pytest.approx(cap, abs=0.05)


def test_a_slit_is_zipped_across_and_never_along() -> None:
    x = np.linspace(0, 1, 60)
    front = np.stack([x, 0.01 * np.ones(60), 0.2 * np.sin(7 * x)], 1)
    ring = np.concatenate([front, front[::-1] * [1, -1, 1]])
    patch = cut.filling(ring, np.arange(120))
    assert len(patch) == 118
    longest = np.linalg.norm(ring[patch] - np.roll(ring[patch], 1, axis=1), axis=2).max()
    assert longest < 0.06
    assert face_areas(Mesh(ring, patch)).sum() == pytest.approx(0.02 * 1.3, rel=0.15)


def test_an_edge_that_is_there_already_is_not_made_again() -> None:
    """A tetrahedron without two faces: their common edge would close the hole on itself."""
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0.5, 1, 0], [0.5, 0.4, 0.02]])
    faces = np.array([[0, 1, 3], [1, 2, 3], [2, 0, 3]])
    ring = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    square = np.array([[0, 1, 2], [0, 2, 3]])
    closed = Mesh(*cut.filled(ring, square, cut.boundary_loops(square)))
    assert len(closed.vertices) == 5
    assert topology(closed).nonmanifold_edges == 0
    assert topology(closed).watertight
    assert topology(Mesh(*cut.filled(vertices, faces, cut.boundary_loops(faces)))).watertight


def test_curves_that_touch_are_told_apart() -> None:
    """Two triangles missing from a fan about one vertex."""
    angle = np.linspace(0, 2 * np.pi, 6, endpoint=False)
    vertices = np.concatenate([[[0, 0]], np.stack([np.cos(angle), np.sin(angle)], 1)])
    faces = np.array([[0, k, k % 6 + 1] for k in (1, 2, 4, 5)])
    assert sorted(len(loop) for loop in cut.boundary_loops(faces)) == [4, 4]
    assert len(vertices) == 7


def test_smoothing_keeps_the_mean_level_and_takes_the_noise() -> None:
    noise = np.random.default_rng(0).normal(size=len(VERTICES))
    assert cut.smoothed(FACES, np.ones(len(VERTICES)), 5) == pytest.approx(1)
    assert cut.smoothed(FACES, noise, 10).std() < 0.25 * noise.std()
