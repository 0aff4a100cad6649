"""Counts on complexes that can be counted by hand."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from mpf_core.quality.topology import smallest_angles, topology
from mpf_core.surface.mesh import Mesh
from tests.mpf_core.quality.meshes import as_mesh, box, grid_sheet, icosphere, joined, moved


def test_closed_surfaces() -> None:
    sphere = topology(icosphere(2))
    assert (sphere.watertight, sphere.euler_characteristic, sphere.components) == (True, 2, 1)
    torus = topology(as_mesh(trimesh.creation.torus(1, 0.3)))
    assert (torus.watertight, torus.euler_characteristic) == (True, 0)
    assert (torus.inconsistent_edges, torus.nonmanifold_vertices) == (0, 0)


def test_a_sheet_has_one_boundary_curve() -> None:
    sheet = topology(grid_sheet(5))
    assert (sheet.boundary_edges, sheet.boundary_loops) == (16, 1)
    assert (sheet.watertight, sheet.euler_characteristic) == (False, 1)
    assert sheet.nonmanifold_vertices == 0


def test_a_moebius_strip_cannot_be_oriented() -> None:
    n = 12
    angle = np.linspace(0, 2 * np.pi, n, endpoint=False)
    across = np.array([-0.3, 0.3])
    radius = 1 + across * np.cos(angle / 2)[:, None]
    points = np.stack(
        [
            radius * np.cos(angle)[:, None],
            radius * np.sin(angle)[:, None],
            across * np.sin(angle / 2)[:, None],
        ],
        axis=2,
    ).reshape(-1, 3)
    i = np.arange(n)
    a, b = 2 * i, 2 * i + 1
    following = (i + 1) % n
    last = following == 0
    c, d = 2 * following + last, 2 * following + 1 - last
    faces = np.concatenate([np.stack([a, c, d], 1), np.stack([a, d, b], 1)])
    strip = topology(Mesh(points, faces))
    assert (strip.boundary_loops, strip.euler_characteristic) == (1, 0)
    assert strip.inconsistent_edges > 0


def test_pieces_and_unused_vertices() -> None:
    pair = joined(box(), moved(icosphere(1), 1.0, np.array([5.0, 0, 0])))
    stray = Mesh(np.concatenate([[[9.0, 9, 9]], pair.vertices]), pair.faces + 1)
    counted = topology(stray)
    assert (counted.components, counted.euler_characteristic) == (2, 4)
    assert counted.vertices == len(pair.vertices)


def test_a_fin_on_an_edge_is_not_manifold() -> None:
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1]])
    fin = topology(Mesh(vertices, np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4]])))
    assert (fin.nonmanifold_edges, fin.nonmanifold_vertices) == (1, 2)


def test_two_cones_that_touch_in_their_tips() -> None:
    cone = trimesh.creation.cone(1, 1, sections=8)
    tip = int(np.argmax(cone.vertices[:, 2]))
    other = cone.vertices * [1, 1, -1] + 2 * cone.vertices[tip]
    count = len(cone.vertices)
    renamed = np.where(cone.faces == tip, tip, cone.faces + count)[:, ::-1]
    both = Mesh(np.concatenate([cone.vertices, other]), np.concatenate([cone.faces, renamed]))
    counted = topology(both)
    assert (counted.nonmanifold_edges, counted.nonmanifold_vertices) == (0, 1)
    assert counted.components == 1


def test_turned_triangle_is_inconsistent() -> None:
    faces = icosphere(1).faces.copy()
    faces[7] = faces[7, ::-1]
    assert topology(Mesh(icosphere(1).vertices, faces)).inconsistent_edges == 3


def test_slivers_and_degenerate_faces() -> None:
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0.5, 0.01, 0], [2, 0, 0], [0.5, 1, 0]])
    faces = np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4], [2, 2, 4]])
    counted = topology(Mesh(vertices, faces))
    assert (counted.slivers, counted.degenerate_faces) == (1, 2)


def test_smallest_angles_of_known_triangles() -> None:
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0.5, np.sqrt(3) / 2, 0]])
    angles = smallest_angles(Mesh(vertices, np.array([[0, 1, 2], [0, 1, 3]])))
    assert angles == pytest.approx([45, 60])


def test_nothing_at_all() -> None:
    nothing = topology(Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int64)))
    assert (nothing.components, nothing.watertight, nothing.euler_characteristic) == (0, False, 0)
