"""Rods: samples whose patches reach round what they lie on."""

from __future__ import annotations

import numpy as np
import pytest

from mpf_core.cloud.neighbors import analyse
from mpf_core.experiments.shapes import sample
from mpf_core.fit.initialize import initialize


def rod(
    radius: float, count: int, *, bend: float = 0.0, noise: float = 0.0
) -> tuple[np.ndarray, ...]:
    """Samples of a rod of length 2, the middles of their sections, their outward normals."""
    rng = np.random.default_rng(0)
    along, angle = rng.uniform(-1, 1, count), rng.uniform(0, 2 * np.pi, count)
    middle = np.stack([bend * along**2, np.zeros(count), along], axis=1)
    tangent = np.stack([2 * bend * along, np.zeros(count), np.ones(count)], axis=1)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    side = np.tile([0.0, 1.0, 0.0], (count, 1))
    normal = np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * np.cross(tangent, side)
    points = middle + (radius + rng.normal(size=(count, 1)) * noise) * normal
    return points, middle, normal


@pytest.mark.parametrize(("bend", "noise"), [(0.0, 0.0), (0.3, 0.0), (0.0, 0.001)])
def test_a_rod_as_thick_as_its_samples_are_apart_is_solid(bend: float, noise: float) -> None:
    """Radius 0.02, spacing about 0.03: PCA's normals are off by twenty degrees and more."""
    points, middle, normal = rod(0.02, 700, bend=bend, noise=noise)
    cloud = analyse(points)
    inner = np.abs(middle[:, 2]) < 0.9
    off = np.degrees(np.arccos(np.clip((cloud.normals * normal).sum(1), -1, 1)))[inner]
    assert (cloud.gap[inner] > 0).mean() > 0.9
    assert np.median(cloud.gap[inner]) == pytest.approx(0.04, rel=0.1)
    assert np.median(off) < 8
    start = initialize(cloud)
    # Inside all along its middle, and outside a radius away from its side.
    assert (start.at(middle[inner]).theta < 0).mean() > 0.95
    assert (start.at((middle + 0.04 * normal)[inner]).theta > 0).mean() > 0.99


def test_a_fold_as_tight_as_a_rod_is_none() -> None:
    """Half of a rod, whose two rims alone are opposite each other."""
    points, _, normal = rod(0.04, 1000)
    assert analyse(points).rods.mean() > 0.9
    assert analyse(points[normal[:, 1] > 0]).rods.mean() < 0.1


def test_a_dress_is_no_rod() -> None:
    assert analyse(sample("dress", 10_000, 1)).rods.mean() < 0.001


@pytest.mark.parametrize(
    ("name", "count"), [("torus", 5000), ("wave", 5000), ("cube-sheet", 10_000)]
)
def test_sheets_and_bodies_have_no_rods(name: str, count: int) -> None:
    assert (analyse(sample(name, count, 0)).gap > 0).mean() < 0.01


def test_square_beams_are_no_rods() -> None:
    """Their faces and edges are found by consensus, which knows them better."""
    rng = np.random.default_rng(0)
    side, along = rng.integers(4, size=4000), rng.uniform(-1, 1, 4000)
    across = rng.uniform(-0.05, 0.05, 4000)
    face = np.full(4000, 0.05)
    x = np.choose(side, [across, face, across, -face])
    y = np.choose(side, [face, across, -face, across])
    assert (analyse(np.stack([x, y, along], axis=1)).gap > 0).mean() < 0.05
