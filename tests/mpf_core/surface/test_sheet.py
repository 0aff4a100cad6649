"""One layer out of closed shells whose walls are known exactly."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from mpf_core.quality.topology import Topology, topology
from mpf_core.surface.cut import boundary_loops
from mpf_core.surface.mesh import Mesh
from mpf_core.surface.rim import Rim
from mpf_core.surface.sheet import SingleLayer, single_layer
from tests.mpf_core.clouds import sphere
from tests.mpf_core.surface.shells import EPSILON, Array, level, shell, square, start_of

SPACING = 0.09  # of 1200 samples on a square of side 1.6, to the 6th neighbour


def scattered(count: int, half: float, seed: int = 0) -> Array:
    """Points of the square |x|, |y| ≤ half at z = 0."""
    flat = np.random.default_rng(seed).uniform(-half, half, size=(count, 2))
    return np.pad(flat, ((0, 0), (0, 1)))


@dataclass(frozen=True)
class Made:
    layer: SingleLayer
    counts: Topology


def made(vertices: Array, faces: Array, points: Array) -> Made:
    start = start_of(points)
    layer = single_layer(vertices, faces, start)
    return Made(layer, topology(Mesh(layer.vertices, layer.faces)))


@pytest.fixture(scope="module")
def flat() -> Made:
    points = scattered(1200, 0.8)
    start = start_of(points)
    up = np.sign(start.normals[:, 2].sum())  # which side of a sheet is its front is a coin's toss

    def theta(x: Array) -> Array:
        height, beyond = square(x)
        return shell(up * height, beyond)

    low = np.array([-1.0, -1, -0.1])
    return made(*level(theta, low, -low), points)


def test_a_wrapped_square_becomes_one_layer(flat: Made) -> None:
    counts = flat.counts
    assert (counts.components, counts.boundary_loops, counts.euler_characteristic) == (1, 1, 1)
    assert counts.nonmanifold_edges == counts.nonmanifold_vertices == 0
    assert counts.inconsistent_edges == counts.degenerate_faces == 0
    assert np.abs(flat.layer.vertices[:, 2]).max() < 1e-6


def test_its_boundary_is_within_a_spacing_of_the_square(flat: Made) -> None:
    (loop,) = boundary_loops(flat.layer.faces)
    edge = flat.layer.vertices[loop, :2]
    off = np.abs(np.abs(edge).max(1) - 0.8)
    assert off.max() < SPACING
    assert off.mean() < 0.25 * SPACING


def test_the_report_tells_what_was_double(flat: Made) -> None:
    layer = flat.layer
    assert layer.double_share > 0.9
    assert layer.thickness == pytest.approx(2 * EPSILON, rel=0.02)
    assert (layer.solids, layer.orientable) == (0, True)


def test_a_hole_in_the_shell_is_closed_and_one_in_the_data_stays() -> None:
    points = scattered(1200, 0.8)
    points = points[np.linalg.norm(points[:, :2] - 0.3, axis=1) > 0.25]
    up = np.sign(start_of(points).normals[:, 2].sum())

    def theta(x: Array) -> Array:
        height, beyond = square(x)
        pinhole = 0.06 - np.linalg.norm(x[:, :2] + 0.3, axis=1)
        data = 0.25 - np.linalg.norm(x[:, :2] - 0.3, axis=1)
        return np.maximum(shell(up * height, beyond), np.maximum(pinhole, data))

    low = np.array([-1.0, -1, -0.1])
    found = made(*level(theta, low, -low), points)
    assert (found.counts.components, found.counts.boundary_loops) == (1, 2)
    assert found.layer.pinholes == 1


def test_a_solid_is_left_as_it_is() -> None:
    low = -np.ones(3) * 0.7
    vertices, faces = level(lambda x: np.linalg.norm(x, axis=1) - 0.5, low, -low)
    layer = single_layer(vertices, faces, start_of(sphere(1500, 0.5)))
    assert layer.vertices is vertices
    assert layer.faces is faces
    assert (layer.double_share, layer.thickness, layer.solids) == (0.0, None, 1)


def box(x: Array, half: float) -> Array:
    past = np.abs(x) - half
    inside = np.minimum(past.max(1), 0)
    return np.linalg.norm(np.maximum(past, 0), axis=1) + inside


def on_box(count: int, half: float, seed: int = 0) -> Array:
    """Points of the surface of a cube."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-half, half, size=(count, 3))
    axis = rng.integers(0, 3, size=count)
    points[np.arange(count), axis] = rng.choice([-half, half], size=count)
    return points


def test_a_sheet_on_a_solid_comes_off_and_the_solid_is_closed() -> None:
    """A cube of side 0.8 with a square sheet of side 0.8 that goes on from its middle."""
    half = 0.4
    wing = scattered(700, half, 1) + np.array([2 * half, 0, 0])
    points = np.concatenate([on_box(4000, half), wing])
    start = start_of(points)
    up = np.sign(start.normals[4000:, 2].sum())

    def theta(x: Array) -> Array:
        height, beyond = square(x - [2 * half, 0, 0], half)
        return np.minimum(box(x, half), shell(up * height, beyond, 0.012))

    low, high = np.array([-0.5, -0.5, -0.5]), np.array([1.3, 0.5, 0.5])
    found = made(*level(theta, low, high, 0.01), points)
    counts, layer = found.counts, found.layer
    assert (counts.components, counts.boundary_loops) == (2, 1)
    assert counts.nonmanifold_edges == counts.inconsistent_edges == 0
    assert (layer.solids, layer.orientable) == (1, True)
    assert layer.thickness == pytest.approx(0.024, rel=0.05)
    assert 0.1 < layer.double_share < 0.25  # 0.64 of 4.48
    sheet = layer.vertices[layer.vertices[:, 0] > half + 0.1]
    assert np.abs(sheet[:, 2]).max() < 0.01
    (loop,) = boundary_loops(layer.faces)
    assert layer.vertices[loop, 0].min() == pytest.approx(half, abs=0.1)


def test_the_rim_is_found_at_the_edge_and_nowhere_else() -> None:
    points = scattered(1200, 0.8)
    rim = Rim.of(start_of(points).local.neighbours)
    assert len(rim.points) > 60
    assert np.abs(rim.points[:, :2]).max(1).min() > 0.8 - 2 * SPACING
    along = np.linspace(-0.6, 0.6, 50)
    outside = np.stack([np.full(50, 0.8 + SPACING), along, np.zeros(50)], 1)
    inside = outside - [2 * SPACING, 0, 0]
    assert (rim.beyond(outside, 1) > 0.8).all()
    assert (rim.beyond(inside, 1) < 0).all()
    assert (rim.beyond(np.zeros((1, 3)), 1) == -3).all()
    closed = Rim.of(start_of(sphere(600, 0.5)).local.neighbours)
    assert len(closed.points) == 0
    assert (closed.beyond(outside, 1) == -3).all()


def test_a_moebius_strip_is_said_to_have_one_side() -> None:
    rng = np.random.default_rng(0)
    turn, across = rng.uniform(0, 2 * np.pi, 2500), rng.uniform(-0.25, 0.25, 2500)
    radius = 0.7 + across * np.cos(turn / 2)
    points = np.stack([radius * np.cos(turn), radius * np.sin(turn), across * np.sin(turn / 2)], 1)
    start = replace(start_of(points), shell=EPSILON)

    def theta(x: Array) -> Array:
        return np.asarray(start.at(x).theta, dtype=np.float64)

    reach = np.abs(points).max(0) + 0.1
    vertices, faces = level(theta, -reach, reach)
    layer = single_layer(vertices, faces, start)
    assert (layer.orientable, layer.solids) == (False, 0)
    counts = topology(Mesh(layer.vertices, layer.faces))
    assert counts.inconsistent_edges == counts.nonmanifold_edges == 0
    assert layer.double_share > 0.8
