"""Double covers whose thickness is known in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from mpf_core.quality.metrics import evaluate
from mpf_core.quality.thickness import double_cover
from mpf_core.surface.mesh import Mesh
from tests.mpf_core.quality.meshes import box, grid_sheet, icosphere, joined, moved


def turned(mesh: Mesh) -> Mesh:
    return Mesh(mesh.vertices, mesh.faces[:, ::-1])


def test_a_thin_plate_is_a_double_cover_of_its_thickness() -> None:
    found = double_cover(box(2, 2, 0.012), samples=4000)
    assert found.thickness == pytest.approx(0.012, abs=1e-6)
    faces, rim = 2 * 2 * 2, 4 * 2 * 0.012  # behind the rim the next wall is 2 away
    assert found.share == pytest.approx(faces / (faces + rim), abs=0.002)


def test_a_shell_around_a_sphere() -> None:
    # Its inside is the space between the two: the inner sphere's triangles look inwards.
    shell = joined(icosphere(5), turned(icosphere(5, radius=0.98)))
    found = double_cover(shell, samples=4000)
    assert found.thickness == pytest.approx(0.02, abs=2e-4)
    assert found.share == pytest.approx(1.0, abs=0.01)


def test_what_lies_behind_free_space_is_no_cover() -> None:
    # The same two spheres with a gap between them that is outside: neither wall has another behind.
    nested = joined(turned(icosphere(4)), icosphere(4, radius=0.98))
    assert double_cover(nested, samples=2000).thickness is None


def test_one_layer_and_thick_bodies_have_none() -> None:
    for mesh in (grid_sheet(5), icosphere(3), box(2, 2, 0.1)):
        found = double_cover(mesh, samples=2000)
        assert (found.share, found.thickness) == (0.0, None)


def test_the_limit_is_in_the_frame_of_the_reference() -> None:
    plate = box(2, 2, 0.012)
    large = moved(plate, 40.0, np.array([500.0, 0, 0]))
    flat = evaluate(large, large, samples=500).as_dict()
    assert flat["double_thickness"] == pytest.approx(0.012, abs=1e-6)
    assert flat["double_share"] > 0.98
