"""Small tangles are parted; a mesh without any stays as it is."""

import numpy as np
import trimesh

from mpf_core.surface.intersections import self_intersections
from mpf_core.surface.mesh import Mesh
from mpf_core.surface.untangle import untangled

SPHERE = trimesh.creation.icosphere(subdivisions=4)
FACES = np.asarray(SPHERE.faces, dtype=np.int64)
VERTICES = np.asarray(SPHERE.vertices)


def test_a_sound_mesh_stays_bit_for_bit() -> None:
    vertices, count = untangled(VERTICES, FACES)

    assert count == 0
    assert np.array_equal(vertices, VERTICES)


def test_vertices_thrown_about_are_parted_where_they_cross() -> None:
    ring = np.unique(FACES[np.any(FACES == 700, axis=1)])
    edge = np.linalg.norm(VERTICES[ring[0]] - VERTICES[ring[1]])
    tangled = VERTICES.copy()
    tangled[ring] += np.random.default_rng(0).normal(0, 0.5 * edge, (len(ring), 3))
    pairs = self_intersections(Mesh(tangled, FACES))
    assert len(pairs)

    vertices, count = untangled(tangled, FACES)

    assert count == len(np.unique(pairs))
    assert not len(self_intersections(Mesh(vertices, FACES)))
    moved = np.linalg.norm(vertices - tangled, axis=1) > 0
    assert moved[np.unique(FACES[np.unique(pairs)])].all()
    assert moved.sum() < 30


def test_nothing_at_all_stays_nothing() -> None:
    assert untangled(np.zeros((0, 3)), np.zeros((0, 3), np.int64))[1] == 0


def test_what_has_no_sharp_edge_is_no_tangle() -> None:
    both = np.concatenate([VERTICES, VERTICES + np.array([0.5, 0.0, 0.0])])
    faces = np.concatenate([FACES, FACES + len(VERTICES)])

    vertices, count = untangled(both, faces)

    assert count == 0
    assert np.array_equal(vertices, both)
