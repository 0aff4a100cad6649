"""Steps are shortened where triangles would fold, collapse or cross, and only there."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from mpf_core.surface import takeback
from mpf_core.surface.intersections import self_intersections
from mpf_core.surface.mesh import Mesh
from mpf_core.surface.normals import face_crosses
from mpf_core.surface.takeback import Motion, allowed_share

Floats = NDArray[np.float64]


def square(height: float, size: int = 12) -> tuple[Floats, NDArray[np.int64]]:
    axis = np.linspace(0, 1, size)
    x, y = np.meshgrid(axis, axis, indexing="ij")
    vertices = np.stack([x.ravel(), y.ravel(), np.full(size * size, height)], axis=1)
    corner = (np.arange(size - 1)[:, None] * size + np.arange(size - 1)).ravel()
    faces = np.concatenate(
        [
            np.stack([corner, corner + size, corner + 1], axis=1),
            np.stack([corner + 1, corner + size, corner + size + 1], axis=1),
        ]
    )
    return vertices, faces


def upward(vertices: Floats, faces: NDArray[np.int64], step: Floats) -> Motion:
    up = np.tile([0.0, 0.0, 1.0], (len(vertices), 1))
    everywhere = np.ones(len(vertices), dtype=bool)
    return Motion(vertices, faces, step, up, everywhere, ~everywhere)


def spoilt(motion: Motion, share: Floats) -> int:
    mesh = motion.at(share)
    before = face_crosses(Mesh(motion.vertices, motion.faces))
    folded = (np.einsum("fi,fi->f", face_crosses(mesh), before) <= 0).sum()
    return int(folded) + len(self_intersections(mesh))


def test_a_harmless_step_is_taken_whole() -> None:
    vertices, faces = square(0.0)
    step = np.zeros_like(vertices)
    step[:, 2] = 0.1 * np.sin(3 * vertices[:, 0])
    motion = upward(vertices, faces, step)
    assert (allowed_share(motion) == 1).all()


def test_a_vertex_that_folds_its_triangles_stays_back_alone() -> None:
    vertices, faces = square(0.0)
    step = np.zeros_like(vertices)
    middle = 5 * 12 + 5
    step[middle] = [0.4, 0.0, 0.0]
    motion = upward(vertices, faces, step)
    assert spoilt(motion, np.ones(len(vertices))) > 0
    share = allowed_share(motion)
    assert spoilt(motion, share) == 0
    far = np.linalg.norm(vertices - vertices[middle], axis=1) > 0.5
    assert (share[far] == 1).all()


def test_walls_that_would_change_places_do_not() -> None:
    low, faces = square(0.0)
    high, _ = square(0.05)
    vertices = np.concatenate([low, high])
    both = np.concatenate([faces[:, ::-1], faces + len(low)])
    step = np.zeros_like(vertices)
    # A bump of the lower wall through the upper one.
    bump = np.exp(-((low[:, :2] - 0.5) ** 2).sum(1) / 0.02)
    step[: len(low), 2] = 0.12 * bump
    outward = np.zeros_like(vertices)
    outward[: len(low), 2], outward[len(low) :, 2] = -1, 1
    still = ~step.any(axis=1)
    motion = Motion(vertices, both, step, outward, still, np.zeros_like(still))
    assert spoilt(motion, np.ones(len(vertices))) > 0
    share = allowed_share(motion)
    assert spoilt(motion, share) == 0
    assert share.max() == 1


def test_a_second_wall_makes_way_for_the_first_and_no_farther_than_it_has_to() -> None:
    first, faces = square(0.0)
    second, _ = square(-0.2)
    second[:, :2] += [0.02, 0.03]  # or edges would meet edges
    vertices = np.concatenate([first, second])
    both = np.concatenate([faces, faces[:, ::-1] + len(first)])
    is_second = np.arange(len(vertices)) >= len(first)
    step = np.zeros_like(vertices)
    step[is_second, 2] = 0.19
    step[~is_second, 2] = -0.03 * np.exp(-((first[:, :2] - 0.5) ** 2).sum(1) / 0.02)
    outward = np.where(is_second, -1.0, 1.0)[:, None] * [0.0, 0.0, 1.0]
    settled = np.ones(len(vertices), dtype=bool)
    motion = Motion(vertices, both, step, outward, settled, is_second)
    assert spoilt(motion, np.ones(len(vertices))) > 0
    share = allowed_share(motion)
    assert spoilt(motion, share) == 0
    assert (share[~is_second] == 1).all()
    assert 0.8 < share[is_second].min() < 1  # 0.01 apart were to be 0.04 where the first wall bends
    far = np.linalg.norm(second[:, :2] - 0.5, axis=1) > 0.5
    assert (share[is_second][far] == 1).all()


def test_crossings_of_what_does_not_move_stay_and_stop_nothing() -> None:
    flat, faces = square(0.0)
    upright = np.stack([flat[:, 0], np.full(len(flat), 0.51), flat[:, 1] - 0.5], axis=1)
    vertices = np.concatenate([flat, upright])
    step = np.zeros_like(vertices)
    moving = np.flatnonzero(flat[:, 1] > 0.9)
    step[moving, 2] = 0.02
    motion = upward(vertices, np.concatenate([faces, faces + len(flat)]), step)
    assert len(self_intersections(Mesh(motion.vertices, motion.faces))) > 0
    assert (allowed_share(motion)[moving] == 1).all()


def test_where_halving_does_not_help_both_walls_stop_at_the_same_place(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(takeback, "SWEEPS", 0)
    low, faces = square(0.0, 30)
    high, _ = square(0.02, 30)
    # Both walls rise, and a slanted plate above a corner stays where it is.
    plate, of_plate = square(0.06, 6)
    plate[:, :2] *= 0.1
    plate[:, 2] += 0.7 * plate[:, 0]
    vertices = np.concatenate([low, high, plate])
    parts = [faces[:, ::-1], faces + len(low), of_plate + 2 * len(low)]
    step = np.zeros_like(vertices)
    step[: 2 * len(low), 2] = 0.1
    outward = np.tile([0.0, 0.0, 1.0], (len(vertices), 1))
    outward[: len(low), 2] = -1
    still = ~step.any(axis=1)
    second = np.zeros_like(still)
    motion = Motion(vertices, np.concatenate(parts), step, outward, still, second)
    assert spoilt(motion, np.ones(len(vertices))) > 0
    share = allowed_share(motion)
    assert spoilt(motion, share) == 0
    np.testing.assert_allclose(share[: len(low)], share[len(low) : 2 * len(low)], atol=0.2)
    far = np.linalg.norm(vertices[:, :2], axis=1) > 0.7
    assert (share[far] == 1).all()
