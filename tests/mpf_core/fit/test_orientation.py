"""Signs of normals: outward where space is enclosed, consistent elsewhere."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import igl
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import sparse

from mpf_core.cloud import rods
from mpf_core.cloud.neighbors import Neighborhoods, analyse
from mpf_core.experiments.shapes import sample, shape
from mpf_core.fit.freespace import FreeSpace, flood
from mpf_core.fit.orientation import agreed_signs, orient, outward_seeds
from mpf_core.surface.normals import face_normals
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


@pytest.mark.parametrize("seed", [0, 1])
def test_pleats_closer_than_their_patches_keep_one_side(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where tight folds are taken for rods, their normals leave these on alternate sides."""
    monkeypatch.setattr(rods, "OPPOSITE", np.inf)
    points, exact = sample("dress", 10_000, seed), shape("dress")
    cloud = analyse(points, threads=1)
    hints = outward_seeds(cloud, flood(cloud))
    _, face, _ = igl.point_mesh_squared_distance(points, exact.vertices, exact.faces)[:3]
    outward = face_normals(exact)[face]
    hinted = np.einsum("ni,ni->n", outward, cloud.normals) * hints
    assert min((hinted > 0).sum(), (hinted < 0).sum()) > 10
    along = np.einsum("ni,ni->n", outward, orient(cloud, hints)) > 0
    assert not 0.002 < along.mean() < 0.998


def grid_evidence(size: int, wrong: float, seed: int) -> tuple[np.ndarray, sparse.csr_array]:
    """Signs of the squares of a board and what neighbours say of them, a share of it wrong."""
    rng = np.random.default_rng(seed)
    signs = rng.choice([-1.0, 1.0], size=size * size)
    number = np.arange(size * size).reshape(size, size)
    steps = ((0, 1), (1, 0), (1, 1), (1, -1))
    pairs = []
    for i, j in steps:
        left, right = max(0, -j), max(0, j)
        pairs.append((number[: size - i, left : size - right], number[i:, right : size - left]))
    tail, head = (np.concatenate([pair[k].ravel() for pair in pairs]) for k in (0, 1))
    said = signs[tail] * signs[head] * rng.uniform(0.5, 1.0, len(tail))
    said[rng.random(len(tail)) < wrong] *= -1
    rows, columns = np.append(tail, size * size), np.append(head, 0)
    one_way = sparse.coo_array((np.append(said, signs[0]), (rows, columns)), (size**2 + 1,) * 2)
    return signs, (one_way + one_way.T).tocsr()


@given(st.integers(2, 20), st.integers(0, 10_000))
def test_evidence_without_a_flaw_is_followed(size: int, seed: int) -> None:
    signs, evidence = grid_evidence(size, 0.0, seed)
    assert np.array_equal(agreed_signs(evidence), signs)


def test_a_few_wrong_links_turn_little_over() -> None:
    """Along a spanning tree one of them turns half of the board over."""
    shares = []
    for seed in range(20):
        signs, evidence = grid_evidence(20, 0.05, seed)
        wrong = float((agreed_signs(evidence) != signs).mean())
        shares.append(min(wrong, 1 - wrong))  # the corner that hangs on the root may be wrong
    assert np.mean(shares) < 0.03
    assert max(shares) < 0.15


def test_evidence_that_cancels_joins_nothing() -> None:
    one_way = sparse.coo_array(([1.0, -1.0], ([0, 0], [1, 1])), (3, 3))
    assert np.array_equal(agreed_signs((one_way + one_way.T).tocsr()), [1.0, 1.0])
