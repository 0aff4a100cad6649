"""Signs of normals: outward where space is enclosed, consistent elsewhere."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from mpf_core.cloud.neighbors import Neighborhoods, analyse
from mpf_core.fit.freespace import FreeSpace
from mpf_core.fit.orientation import orient, outward_seeds
from tests.mpf_core.clouds import plane, sphere

AWAY = np.array([0.6, 0.0, 0.0])

Make = Callable[[str], Neighborhoods]
Flooded = Callable[[str], FreeSpace]


def scrambled(cloud: Neighborhoods, seed: int = 0) -> Neighborhoods:
    """The same neighbourhoods with normals of random sign."""
    sign = np.random.default_rng(seed).choice([-1.0, 1.0], size=(len(cloud.points), 1))
    return replace(cloud, normals=cloud.normals * sign)


@pytest.mark.parametrize("seed", [0, 1])
def test_all_normals_of_a_sphere_point_outwards(
    neighbours: Make, flooded: Flooded, seed: int
) -> None:
    cloud = scrambled(neighbours("sphere"), seed)
    seeds = outward_seeds(cloud, flooded("sphere"))
    assert (seeds != 0).mean() > 0.99
    normals = orient(cloud, seeds)
    assert (np.einsum("ni,ni->n", normals, cloud.points) > 0).all()
    assert np.array_equal(np.abs(normals), np.abs(cloud.normals))


def test_one_seed_turns_the_whole_piece(neighbours: Make) -> None:
    cloud = scrambled(neighbours("sphere"))
    seeds = np.zeros(len(cloud.points))
    seeds[17] = np.sign(cloud.normals[17] @ cloud.points[17])
    assert (np.einsum("ni,ni->n", orient(cloud, seeds), cloud.points) > 0).all()
    assert (np.einsum("ni,ni->n", orient(cloud, -seeds), cloud.points) < 0).all()


@pytest.mark.parametrize("kind", ["hemisphere", "plane"])
def test_open_sheets_get_one_side(neighbours: Make, kind: str) -> None:
    cloud = scrambled(neighbours(kind))
    normals = orient(cloud, np.zeros(len(cloud.points)))
    facing = cloud.points if kind == "hemisphere" else np.array([[-0.2, 0.0, 1.0]])
    signs = np.sign((normals * facing).sum(1))
    assert abs(signs.sum()) == len(signs)


def test_pieces_are_oriented_each_for_itself() -> None:
    points = np.concatenate([sphere(800, 0.3) + AWAY, plane(20) * 0.3 - AWAY])
    cloud = scrambled(analyse(points, threads=1))
    seeds = np.zeros(len(points))
    seeds[0] = np.sign(cloud.normals[0] @ (points[0] - AWAY))
    normals = orient(cloud, seeds)
    assert (np.einsum("ni,ni->n", normals[:800], points[:800] - AWAY) > 0).all()
    assert abs(np.sign(normals[800:, 2]).sum()) == 400


def test_signs_are_carried_across_sharp_edges() -> None:
    """One seed on one face of a cube with exact normals: no sample lies between two faces."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-1, 1, size=(6000, 3))
    rows, axis = np.arange(6000), rng.integers(3, size=6000)
    points[rows, axis] = np.sign(points[rows, axis])
    outward = np.zeros_like(points)
    outward[rows, axis] = points[rows, axis]
    cloud = scrambled(replace(analyse(points, threads=1), normals=outward))
    seeds = np.zeros(6000)
    seeds[0] = np.sign(cloud.normals[0] @ outward[0])
    assert (np.einsum("ni,ni->n", orient(cloud, seeds), outward) > 0).all()
