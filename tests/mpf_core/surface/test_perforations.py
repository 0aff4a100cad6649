"""Pinholes through the shell of a sheet, and holes that the object has."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from skimage.measure import marching_cubes

from mpf_core.quality.topology import topology
from mpf_core.surface import perforations
from mpf_core.surface.mesh import Mesh
from mpf_core.surface.perforations import without_perforations

Array = NDArray[np.float64]
SPACING = 0.06  # to the sixth neighbour, of 3000 samples on a disc of radius 0.8


def shell(holes: list[tuple[float, float, float]], bend: float = 0.0) -> Mesh:
    """A round plate 0.03 thick, bent, with holes (x, y, radius)."""
    axis = np.linspace(-1, 1, 161)
    height = np.linspace(-0.3, 0.3, 121)
    x, y, z = np.meshgrid(axis, axis, height, indexing="ij")
    theta = np.maximum(np.abs(z - bend * (x**2 - y**2)) - 0.015, np.hypot(x, y) - 0.8)
    for at_x, at_y, radius in holes:
        theta = np.maximum(theta, radius - np.hypot(x - at_x, y - at_y))
    step = (axis[1] - axis[0], axis[1] - axis[0], height[1] - height[0])
    vertices, faces, _, _ = marching_cubes(theta, 0.0, spacing=step)
    return Mesh(vertices - [1, 1, 0.3], faces[:, ::-1].astype(np.int64))


def samples(holes: list[tuple[float, float, float]], bend: float = 0.0) -> cKDTree:
    points = np.random.default_rng(0).uniform(-0.8, 0.8, size=(4000, 2))
    keep = np.hypot(*points.T) < 0.8
    for x, y, radius in holes:
        keep &= np.hypot(points[:, 0] - x, points[:, 1] - y) > radius
    points = points[keep]
    return cKDTree(np.column_stack([points, bend * (points[:, 0] ** 2 - points[:, 1] ** 2)]))


PINHOLES = [(0.1, 0.2, 0.02), (-0.4, 0.1, 0.035), (0.3, -0.4, 0.045), (0.36, -0.32, 0.03)]


@pytest.mark.parametrize("bend", [0.0, 0.25])
def test_pinholes_are_closed(bend: float) -> None:
    mesh = shell(PINHOLES, bend)
    assert topology(mesh).euler_characteristic == 2 - 2 * len(PINHOLES)
    vertices, faces, closed = without_perforations(
        mesh.vertices, mesh.faces, samples([], bend), SPACING
    )
    after = topology(Mesh(vertices, faces))
    assert closed >= 3  # the two beside each other may count as one place
    assert after.euler_characteristic == 2
    assert after.boundary_edges == after.nonmanifold_edges == after.inconsistent_edges == 0
    # The caps lie in the walls.
    off = np.abs(vertices[:, 2] - bend * (vertices[:, 0] ** 2 - vertices[:, 1] ** 2))
    assert off.max() < 0.017
    assert off[np.hypot(*vertices[:, :2].T) < 0.7].min() > 0.012


def test_a_hole_that_the_samples_leave_out_stays() -> None:
    """Twice as wide as samples are apart: random ones leave such a gap once in ten thousand."""
    holes = [(0.0, 0.0, 0.11)]
    mesh = shell(holes)
    vertices, faces, closed = without_perforations(
        mesh.vertices, mesh.faces, samples(holes), SPACING
    )
    assert closed == 0
    assert np.array_equal(faces, mesh.faces)
    assert np.array_equal(vertices, mesh.vertices)


def test_a_whole_shell_is_left_as_it_is() -> None:
    mesh = shell([])
    _, faces, closed = without_perforations(mesh.vertices, mesh.faces, samples([]), SPACING)
    assert closed == 0
    assert np.array_equal(faces, mesh.faces)


def test_too_many_places_are_no_pinholes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(perforations, "MOST", 2)
    mesh = shell(PINHOLES)
    vertices, faces, closed = without_perforations(mesh.vertices, mesh.faces, samples([]), SPACING)
    assert closed == 0
    assert np.array_equal(faces, mesh.faces) and np.array_equal(vertices, mesh.vertices)
