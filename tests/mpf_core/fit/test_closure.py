"""Winding numbers close gaps, and leave open what is open."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pytest

from mpf_core.cloud.neighbors import Neighborhoods, analyse
from mpf_core.cloud.normalize import Similarity
from mpf_core.experiments.shapes import sample
from mpf_core.fit import closure
from mpf_core.fit.closure import close_gaps
from mpf_core.fit.freespace import INSIDE, FreeSpace
from mpf_core.fit.initialize import Initialization, initialize
from mpf_core.known import known_of
from mpf_core.options import Options
from mpf_core.watch import Watch
from tests.mpf_core.fit.conftest import RADIUS

Make = Callable[[str], Neighborhoods]
Flooded = Callable[[str], FreeSpace]
Start = Callable[[str], Initialization]


def outward(cloud: Neighborhoods) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    return cloud.points / np.linalg.norm(cloud.points, axis=1, keepdims=True)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_sphere_without_a_small_cap_is_closed_by_winding_numbers(
    neighbours: Make, flooded: Flooded, sign: float
) -> None:
    kind = "gap"
    cloud = neighbours(kind)
    leaky = flooded(kind)
    closed = close_gaps(cloud, sign * outward(cloud), leaky)
    assert leaky.enclosures == 0
    assert closed.enclosures == 1
    inside = closed.position(np.argwhere(closed.labels == INSIDE).astype(np.float64))
    assert np.linalg.norm(inside, axis=1).max() < 1.1 * RADIUS
    assert closed.label_at(np.zeros((1, 3)))[0] == INSIDE
    assert closed.near_inside.any()
    assert (leaky.labels != INSIDE).all()  # the flood's own labels stay


@pytest.mark.parametrize("kind", ["hemisphere", "plane"])
def test_bowls_and_sheets_stay_open(neighbours: Make, flooded: Flooded, kind: str) -> None:
    cloud = neighbours(kind)
    space = flooded(kind)
    normals = outward(cloud) if kind == "hemisphere" else cloud.normals
    assert close_gaps(cloud, normals, space) is space


def test_the_warm_start_closes_the_gap_and_not_the_bowl(start: Start) -> None:
    assert start("sphere").space.enclosures == 1
    assert start("gap").space.enclosures == 1
    assert start("gap").seeded > 0.8
    assert start("hemisphere").space.enclosures == 0
    assert start("hemisphere").seeded == 0


@pytest.mark.parametrize("noise", [0.0, 0.005, 0.01])
def test_holes_are_seen_through_noise(noise: float) -> None:
    """Discs of thinned and smoothed samples reach farther into a hole than their spacing; with 1 %
    crumbs of the lid lie between it and all ends of the surface."""
    points = sample("holed-body", 20_000, 0, noise=noise)
    points = Similarity.of(points).to_normalised(points)
    start = known_of(points, Options(), Watch(time.monotonic, None, None), 2).start
    assert start is not None
    assert start.seeded > 0.9


@pytest.mark.parametrize(("shape", "solid"), [("holed-body", True), ("vase", False)])
def test_outliers_end_no_surface(shape: str, solid: bool) -> None:
    points = sample(shape, 20_000, 0, outliers=0.01)
    points = Similarity.of(points).to_normalised(points)
    seeded = initialize(analyse(points)).seeded
    assert seeded > 0.9 if solid else seeded == 0


def test_discs_merged_by_voxels_wind_around_the_same(
    neighbours: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    cloud = neighbours("gap")
    normals = outward(cloud)
    x = np.random.default_rng(0).uniform(-1, 1, (2000, 3))
    x = x[np.abs(np.linalg.norm(x, axis=1) - RADIUS) > 0.3]
    every = np.ones(len(normals), dtype=bool)
    apart = closure._winding_at(x, cloud, normals, 0.12, every)
    monkeypatch.setattr(closure, "MANY", 0)
    merged = closure._winding_at(x, cloud, normals, 0.12, every)
    assert 0 < np.abs(merged - apart).max() < 0.02
    middles, discs = closure._merged(cloud.points, normals, np.ones(len(normals)), 0.12)
    assert len(middles) < len(normals) / 2
    assert discs.sum(0) == pytest.approx(normals.sum(0), abs=1e-6)
