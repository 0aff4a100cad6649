"""The flood stops at samples: what is enclosed, what is not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from mpf_core.cloud.neighbors import Neighborhoods, analyse
from mpf_core.fit.freespace import HALF_BOX, INSIDE, OUTSIDE, SURFACE, FreeSpace, flood
from tests.mpf_core.clouds import sphere
from tests.mpf_core.fit.conftest import RADIUS

Make = Callable[[str], Neighborhoods]
Flooded = Callable[[str], FreeSpace]


def share(space: FreeSpace, label: int) -> float:
    return float((space.labels == label).mean())


def test_a_sphere_encloses_its_ball(flooded: Flooded) -> None:
    space = flooded("sphere")
    assert space.enclosures == 1
    box = (2 * HALF_BOX) ** 3
    ball = 4 / 3 * np.pi * RADIUS**3 / box
    assert 0.75 * ball < share(space, INSIDE) < ball
    assert share(space, OUTSIDE) < 1 - ball
    origin, corner = np.zeros((1, 3)), np.full((1, 3), HALF_BOX)
    assert space.label_at(origin)[0] == INSIDE
    assert space.label_at(corner)[0] == OUTSIDE


@pytest.mark.parametrize("kind", ["sphere", "hemisphere", "plane"])
def test_samples_lie_in_voxels_of_the_surface_or_beside_one(
    neighbours: Make, flooded: Flooded, kind: str
) -> None:
    space = flooded(kind)
    surface = ndimage.binary_dilation(space.labels == SURFACE)
    covered = replace(space, labels=np.where(surface, SURFACE, OUTSIDE).astype(np.int8))
    assert (covered.label_at(neighbours(kind).points) == SURFACE).all()


@pytest.mark.parametrize("kind", ["hemisphere", "plane", "gap"])
def test_the_flood_enters_what_is_open(flooded: Flooded, kind: str) -> None:
    space = flooded(kind)
    assert space.enclosures == 0
    assert share(space, INSIDE) == 0
    assert not space.near_inside.any()


def test_a_sphere_in_a_sphere_has_two_enclosures() -> None:
    points = np.concatenate([sphere(3000, 0.95), sphere(1200, 0.5)])
    space = flood(analyse(points, threads=1))
    assert space.enclosures == 2
    assert (space.label_at(np.array([[0.0, 0, 0], [0.72, 0, 0]])) == INSIDE).all()


def test_voxels_beside_enclosed_space_are_unlabelled_and_near_the_surface(
    neighbours: Make, flooded: Flooded
) -> None:
    space = flooded("sphere")
    beside = np.argwhere(space.near_inside)
    assert len(beside) > 1000
    assert (space.labels[space.near_inside] == SURFACE).all()
    at = space.position(beside.astype(np.float64))
    assert space.is_near_inside(at).all()
    off = np.abs(np.linalg.norm(at, axis=1) - RADIUS)
    assert off.max() < neighbours("sphere").disc_radius.max() + 2 * space.voxel


def test_positions_are_clamped_to_the_grid(neighbours: Make) -> None:
    space = flood(neighbours("plane"), resolution=40)
    far = np.array([[9.0, 9, 9], [-9, -9, -9]])
    assert (space.label_at(far) == OUTSIDE).all()
    assert space.voxel == pytest.approx(2 * HALF_BOX / 39)


@pytest.mark.parametrize("count", [60, 200])
@pytest.mark.parametrize("seed", range(3))
def test_a_sparse_sheet_does_not_part_the_box(count: int, seed: int) -> None:
    """Its discs reach over the border, where the space on both sides must stay one."""
    points = np.random.default_rng(seed).uniform(-1, 1, size=(count, 3)) * [1, 1, 0]
    space = flood(analyse(points, threads=1), resolution=80)
    assert space.enclosures == 0
