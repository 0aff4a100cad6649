"""Two sides of a thin wall are told apart; one sheet, noisy, bent, folded or joined, is not."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mpf_core.cloud.layers import Layers, split
from mpf_core.cloud.neighbors import NEAREST, analyse

Array = NDArray[np.float64]


def square(count: int = 1500, seed: int = 0) -> Array:
    """(count, 2) random in [-1, 1]²: a spacing of about 0.1 to the sixth neighbour."""
    return np.random.default_rng(seed).uniform(-1, 1, size=(count, 2))


def over(flat: Array, height: Callable[[Array, Array], Array]) -> Array:
    x, y = flat.T
    return np.column_stack([flat, height(x, y)])


def patches(points: Array, inner: float = 0.7) -> tuple[Layers, NDArray[np.bool_]]:
    """The split of all patches, and which of them lie away from the rim."""
    index = cKDTree(points).query(points, NEAREST + 1)[1]
    return split(points[index]), (np.abs(points[:, :2]) < inner).all(1)


def wall(gap: float, bend: float, noise: float = 0.0) -> tuple[Array, Array]:
    rng = np.random.default_rng(1)
    side = rng.choice([-0.5, 0.5], size=1500)
    points = over(square(), lambda x, y: bend * np.sin(2 * x) * np.cos(2 * y))
    points[:, 2] += side * gap + noise * rng.normal(size=1500)
    return points, side


@pytest.mark.parametrize("gap", [0.12, 0.08, 0.03])
@pytest.mark.parametrize("bend", [0.0, 0.2])
def test_a_thin_wall_is_two_layers_that_look_away_from_each_other(gap: float, bend: float) -> None:
    points, side = wall(gap, bend)
    found, inner = patches(points)
    assert found.layered[inner].mean() > 0.85
    told = found.layered & inner
    assert (np.sign(found.away[told, 2]) == np.sign(side[told])).all()
    assert found.gap[told] == pytest.approx(gap, rel=0.2, abs=0.01)
    index = cKDTree(points).query(points, NEAREST + 1)[1]
    right = side[index] == side[:, None]
    assert (right | ~found.own)[told].mean() > 0.99


def test_a_little_noise_does_not_hide_the_layers() -> None:
    found, inner = patches(wall(0.08, 0.2, noise=0.006)[0])
    assert found.layered[inner].mean() > 0.8


ONE = {
    "noisy": over(square(), lambda x, y: 0.05 * np.random.default_rng(3).normal(size=len(x))),
    "bent": over(square(), lambda x, y: 0.25 * np.sin(3 * x) * np.cos(2.5 * y)),
    "uniform": over(square(), lambda x, y: np.random.default_rng(3).uniform(0, 0.2, size=len(x))),
    "roof": over(square(), lambda x, y: -np.abs(x)),
    "step": over(square(), lambda x, y: 0.1 * (x > 0)),
}


@pytest.mark.parametrize("kind", ONE)
def test_one_sheet_stays_one(kind: str) -> None:
    assert patches(ONE[kind])[0].layered.mean() < 0.01
    assert not analyse(ONE[kind], threads=1).layered.any()


def test_a_junction_is_not_a_wall() -> None:
    lying = np.column_stack([square(), np.zeros(1500)])
    y, z = square(750, seed=4).T
    standing = np.column_stack([np.zeros(750), y, (z + 1) / 2])
    both = np.concatenate([lying, standing])
    assert patches(both)[0].layered.mean() < 0.02
    assert not analyse(both, threads=1).layered.any()


def test_neighbourhoods_of_a_wall_are_those_of_its_sides() -> None:
    points, side = wall(0.05, 0.1)
    found = analyse(points, threads=1)
    inner = (np.abs(points[:, :2]) < 0.7).all(1)
    told = found.layered & inner
    assert told.sum() > 0.85 * inner.sum()
    alone = analyse(points[side > 0], threads=1)
    there = told[side > 0]
    cosine = np.einsum("ni,ni->n", found.normals[side > 0], alone.normals)[there]
    assert np.abs(cosine).mean() > 0.999
    assert (side[found.links[told]] == side[told][:, None]).mean() > 0.99
    assert not found.rim[told].any(1).mean() > 0.01
    assert found.spacing[side > 0][there] == pytest.approx(alone.spacing[there], rel=0.3)


@pytest.mark.parametrize("scale", [1e-12, 1.0, 1e9])
def test_points_on_a_line_or_on_one_spot_are_finite(scale: float) -> None:
    line = np.zeros((1, 51, 3))
    line[0, :, 0] = np.arange(51) * scale
    for patch in (line, np.zeros((1, 51, 3))):
        found = split(patch)
        assert not found.layered.any()
        assert np.isfinite(found.away).all()
