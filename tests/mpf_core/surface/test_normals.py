"""Angles at the corners of triangles."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mpf_core.surface.mesh import Mesh
from mpf_core.surface.normals import corner_angles


def test_of_a_right_triangle() -> None:
    mesh = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, np.sqrt(3), 0]]), np.array([[0, 1, 2]]))
    assert np.allclose(corner_angles(mesh), np.pi * np.array([[1 / 2, 1 / 3, 1 / 6]]))


def test_sides_without_length_have_no_angles() -> None:
    vertices = np.array([[0.0, 0, 0], [0, 0, 0], [1, 2, 3], [2, 4, 6]])
    faces = np.array([[0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 1, 1], [2, 2, 2]])
    assert np.array_equal(corner_angles(Mesh(vertices, faces)), np.zeros((5, 3)))
    needle = corner_angles(Mesh(vertices, np.array([[0, 2, 3]])))
    assert np.allclose(needle, [[0, np.pi, 0]])


@given(st.integers(0, 2**32 - 1), st.floats(1e-6, 1e6))
def test_they_add_up_to_half_a_turn(seed: int, scale: float) -> None:
    corners = scale * np.random.default_rng(seed).normal(size=(30, 3))
    angles = corner_angles(Mesh(corners, np.arange(30).reshape(-1, 3)))
    assert np.allclose(angles.sum(1), np.pi)
