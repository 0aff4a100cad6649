"""Which enclosed regions are filled, and what each sample bounds."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from mpf_core.cloud.neighbors import analyse
from mpf_core.fit.freespace import INSIDE, OUTSIDE, flood
from mpf_core.fit.initialize import Initialization, initialize
from mpf_core.fit.sides import parted
from tests.mpf_core.clouds import plane, sphere

Array = NDArray[np.float64]
EDGE = 0.8


def box(count: int, half: tuple[float, float, float], seed: int = 0) -> Array:
    """(count, 3) random on the faces of a box about the origin, by area."""
    rng, sides = np.random.default_rng(seed), np.array(half)
    area = np.repeat([sides[1] * sides[2], sides[0] * sides[2], sides[0] * sides[1]], 2)
    face = rng.choice(6, size=count, p=area / area.sum())
    points = rng.uniform(-1, 1, size=(count, 3)) * sides
    rows = np.arange(count)
    points[rows, face // 2] = sides[face // 2] * np.where(face % 2, 1.0, -1.0)
    return points


def start_of(points: Array) -> Initialization:
    return initialize(analyse(points, threads=1), threads=1)


def test_a_cavity_is_free_space_and_both_walls_change_sign() -> None:
    start = start_of(np.concatenate([sphere(3000, 0.9), sphere(1500, 0.5)]))
    x = np.array([[0.0, 0, 0], [0.7, 0, 0], [0, -0.7, 0], [1.05, 0, 0], [0.45, 0, 0], [0, 0.85, 0]])
    assert np.sign(start.at(x).theta).tolist() == [1, -1, -1, 1, 1, -1]
    assert start.space.enclosures == 1
    inner = start.normals[3000:]
    assert (np.einsum("ni,ni->n", inner, start.local.neighbours.points[3000:]) < 0).all()


def test_without_contradiction_each_of_several_bodies_is_filled() -> None:
    away = np.array([0.55, 0.0, 0.0])
    points = np.concatenate([sphere(2000, 0.4) + away, sphere(2000, 0.4) - away])
    neighbours = analyse(points, threads=1)
    space = parted(neighbours, flood(neighbours))
    assert space.enclosures == 2
    assert (space.label_at(np.stack([away, -away])) == INSIDE).all()
    assert space.label_at(np.zeros((1, 3)))[0] == OUTSIDE


def test_a_sheet_in_a_closed_box_is_an_empty_slit() -> None:
    partition = plane(32)[:, [2, 0, 1]] * EDGE
    start = start_of(np.concatenate([box(6000, (EDGE,) * 3), partition]))
    buried = start.bounds.buried[6000:]
    inner = (np.abs(partition[:, 1:]) < 0.6).all(1)
    assert (buried[inner] > 0.5).all()
    at = partition[inner]
    slit = at - start.shell * start.normals[6000:][inner]
    assert np.abs(start.at(at).theta).max() < 0.3 * start.shell
    assert (start.at(slit).theta > 0).all()
    both = np.array([[0.4, 0.1, 0.2], [-0.4, 0.1, 0.2]])
    assert (start.at(both).theta < -0.3).all()


@pytest.mark.parametrize("half_thickness", [0.03, 0.012, 0.005])
def test_a_plate_thinner_than_the_spacing_is_solid(half_thickness: float) -> None:
    points = box(3000, (0.9, 0.9, half_thickness))
    start = start_of(points)
    assert start.seeded > 0.9
    assert start.thinnest == pytest.approx(2 * half_thickness, rel=0.2)
    x = np.random.default_rng(2).uniform(-0.75, 0.75, size=(1000, 3))
    x[:, 2] = np.linspace(-3, 3, 1000) * half_thickness
    exact = np.abs(x[:, 2]) - half_thickness
    found = start.at(x)
    assert np.abs(found.theta - exact).mean() < 0.02 * half_thickness + 1e-4
    assert (np.sign(found.theta) == np.sign(exact))[np.abs(exact) > 0.001].mean() > 0.995
    beyond = np.array([[1.0, 0.0, 0.0], [0.0, -0.98, 0.5 * half_thickness]])
    assert (start.at(beyond).theta > 0).all()
