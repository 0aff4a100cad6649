"""Meshes that touch themselves, made manifold."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from mpf_core.quality.topology import topology
from mpf_core.surface.manifold import separated
from mpf_core.surface.mesh import Mesh

Array = NDArray[np.float64]
Faces = NDArray[np.int64]


def volume(vertices: Array, faces: Faces) -> float:
    """Enclosed by the mesh."""
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    return float(np.einsum("fi,fi->", a, np.cross(b, c)) / 6)


def tetrahedra(*, sharing: int) -> tuple[Array, Faces]:
    """Two that share so many vertices: a corner, or an edge of four triangles."""
    first = np.array([[0, 0, 0], [1, 0, 0], [0.3, 1, 0.2], [0.3, -0.2, 1]], dtype=float)
    second = first * [1, -1, -1]
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    names = np.where(np.arange(4) < sharing, np.arange(4), np.arange(4) + 4)
    vertices = np.concatenate([first, second])
    vertices[4 : 4 + sharing] = first[:sharing]
    return vertices, np.concatenate([faces, names[faces[:, ::-1]]])


def test_what_is_manifold_is_returned_as_it_is() -> None:
    ball = trimesh.creation.icosphere(subdivisions=2)
    vertices, faces = separated(ball.vertices, ball.faces.astype(np.int64))
    np.testing.assert_array_equal(vertices, ball.vertices)
    np.testing.assert_array_equal(faces, ball.faces)


def test_two_solids_that_share_a_corner_are_parted() -> None:
    vertices, faces = separated(*tetrahedra(sharing=1))
    found = topology(Mesh(vertices, faces))
    assert (found.nonmanifold_vertices, found.components) == (0, 2)
    assert found.euler_characteristic == 4


def test_two_solids_that_share_an_edge_are_parted() -> None:
    vertices, faces = tetrahedra(sharing=2)
    before = topology(Mesh(vertices, faces))
    assert before.nonmanifold_edges == 1
    points, parted = separated(vertices, faces)
    after = topology(Mesh(points, parted))
    assert (after.watertight, after.nonmanifold_edges, after.nonmanifold_vertices) == (True, 0, 0)
    # Two triangles were cut in halves, and nothing moved.
    assert len(parted) == len(faces) + 2
    assert volume(points, parted) == pytest.approx(volume(vertices, faces))


def tunnel(levels: int = 5, around: int = 4) -> tuple[Array, Faces]:
    """A ball-like tube, closed at both ends, whose waist has been pulled together to one edge: the
    two halves of its ring lie on one another."""
    angle = 2 * np.pi * np.arange(around) / around
    rings = [
        np.stack([np.cos(angle), np.sin(angle), np.full(around, float(z))], axis=1)
        for z in range(levels)
    ]
    vertices = np.concatenate([*rings, [[0, 0, -1], [0, 0, levels]]])
    faces = []
    for z in range(levels - 1):
        for k in range(around):
            a, b = z * around + k, z * around + (k + 1) % around
            faces += [[a, b, b + around], [a, b + around, a + around]]
    for k in range(around):
        faces.append([(k + 1) % around, k, levels * around])
        top = (levels - 1) * around
        faces.append([top + k, top + (k + 1) % around, levels * around + 1])
    middle = levels // 2 * around
    names = np.arange(len(vertices))
    names[middle + 1], names[middle + 2] = middle, middle + 3  # 4 corners of the waist to 2
    merged = names[np.array(faces)]
    whole = (merged != np.roll(merged, 1, axis=1)).all(1)
    return vertices, merged[whole]


def test_a_waist_pulled_into_an_edge_is_parted_though_both_pairs_keep_both_ends() -> None:
    vertices, faces = tunnel()
    before = topology(Mesh(vertices, faces))
    assert before.boundary_edges == 0
    assert before.nonmanifold_edges > 0
    points, parted = separated(vertices, faces)
    after = topology(Mesh(points, parted))
    assert (after.watertight, after.nonmanifold_edges, after.nonmanifold_vertices) == (True, 0, 0)
    assert after.inconsistent_edges == 0


def test_triangles_on_one_another_go() -> None:
    ball = trimesh.creation.icosphere(subdivisions=1)
    flap = np.array([[0, 1, 2], [2, 1, 0]])
    faces = np.concatenate([ball.faces, flap]).astype(np.int64)
    points, parted = separated(ball.vertices, faces)
    assert len(parted) == len(ball.faces)
    assert topology(Mesh(points, parted)).watertight


@pytest.mark.parametrize("seed", range(5))
def test_any_pairs_of_merged_vertices_far_apart_leave_a_closed_manifold(seed: int) -> None:
    """Merging two corners of a ball makes vertices, not edges, that are no manifold; merging the
    ends of two edges makes edges of four triangles."""
    rng = np.random.default_rng(seed)
    ball = trimesh.creation.icosphere(subdivisions=3)
    faces = ball.faces.astype(np.int64)
    edges = ball.edges_unique[rng.permutation(len(ball.edges_unique))[:6]].reshape(3, 2, 2)
    used = edges.ravel()
    if len(np.unique(used)) < len(used):
        pytest.skip("the edges drawn share a vertex")
    names = np.arange(len(ball.vertices))
    for one, other in edges:
        names[other] = one
    merged = names[faces]
    merged = merged[(merged != np.roll(merged, 1, axis=1)).all(1)]
    if topology(Mesh(ball.vertices, merged)).boundary_edges:
        pytest.skip("neighbours were merged")
    points, parted = separated(ball.vertices, merged)
    assert topology(Mesh(points, parted)).nonmanifold_edges == 0
