"""Triangles finer than the samples' spacing are merged."""

from __future__ import annotations

import numpy as np
import trimesh

from mpf_core.options import PRESETS
from mpf_core.quality.topology import topology
from mpf_core.surface.coarsen import FEWEST, coarsened, most_faces, wanted_faces
from mpf_core.surface.mesh import Mesh

BALL = trimesh.creation.icosphere(subdivisions=6)  # 81,920 faces
VERTICES = np.asarray(BALL.vertices)
FACES = BALL.faces.astype(np.int64)
MOST = 500_000


def test_as_many_faces_are_left_as_the_spacing_asks_for() -> None:
    spacing = 0.08
    wanted = wanted_faces(VERTICES, FACES, spacing, MOST)
    assert FEWEST < wanted < len(FACES)
    vertices, faces = coarsened(VERTICES, FACES, spacing, MOST)
    assert abs(len(faces) - wanted) < 0.03 * wanted
    assert topology(Mesh(vertices, faces)).watertight
    # The height of a cap over an edge e of a ball of radius 1 is e² / 8; decimation makes some
    # edges longer than the mean.
    assert np.abs(np.linalg.norm(vertices, axis=1) - 1).max() < 4 * (spacing / 2.5) ** 2 / 8


def test_a_mesh_that_is_not_too_fine_stays_as_it_is() -> None:
    vertices, faces = coarsened(VERTICES, FACES, 0.05, MOST)
    assert vertices is VERTICES
    assert faces is FACES


def test_few_faces_are_always_kept() -> None:
    assert wanted_faces(VERTICES, FACES, 1.0, MOST) == FEWEST


def test_a_draft_has_time_for_fewer_faces_and_a_scene_gets_more() -> None:
    draft, balanced = (PRESETS[name].surface for name in ("draft", "balanced"))
    assert most_faces(draft) == 150_000 < most_faces(balanced)
    assert most_faces(draft, networks=3) == 450_000
    assert most_faces(balanced, networks=100) == 2_000_000
    _, faces = coarsened(VERTICES, FACES, 0.001, 40_000)
    assert len(faces) == 40_000
