"""The sparse extraction against the dense one, and its promises."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from skimage.measure import marching_cubes

from mpf_core.errors import Cancelled, NoSurface, ResolutionTooHigh
from mpf_core.quality.topology import topology
from mpf_core.surface.isosurface import Grid, Isosurface, extract
from mpf_core.surface.mesh import Mesh
from tests.mpf_core.clouds import sphere

Points = NDArray[np.float64]
Field = Callable[[Points], NDArray[np.float32]]
LOW, HIGH = np.full(3, -1.05), np.full(3, 1.05)


def ball(x: Points) -> NDArray[np.float32]:
    return (np.linalg.norm(x, axis=1) - 0.713).astype(np.float32)


def wall(x: Points) -> NDArray[np.float32]:
    """Sides two cells apart."""
    return (np.abs(np.linalg.norm(x, axis=1) - 0.7131) - 0.035).astype(np.float32)


def shell(x: Points) -> NDArray[np.float32]:
    """Walls 0.04 apart: thinner than a cell of the coarse levels."""
    return (np.abs(np.linalg.norm(x, axis=1) - 0.7131) - 0.02).astype(np.float32)


def gyroid(x: Points) -> NDArray[np.float32]:
    """Scaled so that its slope on the surface is near 1; cut off by a ball."""
    k = 5.0
    s, c = np.sin(k * x), np.cos(k * x)
    wave = (s[:, 0] * c[:, 1] + s[:, 1] * c[:, 2] + s[:, 2] * c[:, 0]) / (1.5 * k)
    return np.maximum(wave, np.linalg.norm(x, axis=1) - 0.9).astype(np.float32)


def extracted(field: Field, resolution: int = 64) -> Isosurface:
    grid = Grid.around(LOW, HIGH, resolution)
    return extract(field, grid, cKDTree(sphere(300, 0.713)), reach=0.1)


def dense(field: Field, grid: Grid) -> tuple[int, int]:
    """Vertices and faces of marching cubes over every cell."""
    axes = [np.arange(n + 1) for n in grid.shape]
    at = grid.points(np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3))
    vertices, faces, _, _ = marching_cubes(
        field(at).reshape(grid.shape + 1), 0.0, method="lorensen"
    )
    return len(vertices), len(faces)


def crossings(field: Field, grid: Grid) -> int:
    """Edges of the full grid whose ends differ in sign: one vertex each."""
    axes = [np.arange(n + 1) for n in grid.shape]
    at = grid.points(np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3))
    negative = field(at).reshape(grid.shape + 1) < 0
    return sum(int(np.diff(negative, axis=axis).sum()) for axis in range(3))


@pytest.mark.parametrize("field", [ball, shell, gyroid])
def test_nothing_is_missed_and_nothing_doubled(field: Field) -> None:
    surface = extracted(field)
    assert len(surface.vertices) == crossings(field, surface.grid)
    cells = int(np.prod(surface.grid.shape))
    assert surface.evaluations < 0.8 * cells


@pytest.mark.parametrize("field", [ball, wall, shell])
def test_counts_are_those_of_dense_marching_cubes(field: Field) -> None:
    """The walls of the shell make ambiguous faces: both tables keep the inside connected there."""
    surface = extracted(field)
    assert (len(surface.vertices), len(surface.faces)) == dense(field, surface.grid)


@pytest.mark.parametrize(
    ("field", "components", "euler"),
    [(ball, 1, 2), (wall, 2, 4), (shell, 2, 4)],
    ids=["ball", "wall", "shell"],
)
def test_topology_is_right(field: Field, components: int, euler: int) -> None:
    surface = extracted(field)
    counted = topology(Mesh(surface.vertices, surface.faces))
    assert counted.watertight
    assert (counted.components, counted.euler_characteristic) == (components, euler)


def test_vertices_lie_on_the_zero_level() -> None:
    surface = extracted(ball)
    assert np.abs(ball(surface.vertices)).max() < 1e-3 * surface.grid.cell


def test_faces_look_outwards() -> None:
    surface = extracted(ball)
    a, b, c = (surface.vertices[surface.faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    assert (np.einsum("fi,fi->f", normal, a + b + c) > 0).all()
    assert np.einsum("fi,fi->f", a, normal).sum() / 6 == pytest.approx(
        4 / 3 * np.pi * 0.713**3, rel=0.01
    )


def test_a_field_without_zero_level_has_no_surface() -> None:
    with pytest.raises(NoSurface) as told:
        extracted(lambda x: np.ones(len(x), dtype=np.float32))
    assert told.value.advice


def test_too_fine_a_grid_is_refused_with_one_that_fits() -> None:
    grid = Grid.around(LOW, HIGH, 256)
    with pytest.raises(ResolutionTooHigh) as told:
        extract(ball, grid, cKDTree(sphere(300, 0.713)), reach=0.1, memory_limit=2**20)
    assert told.value.where == "resolution"
    assert told.value.advice
    assert int(told.value.advice.rstrip(".").split()[-1]) < 256


def test_cancel_is_heard_between_levels() -> None:
    asked: list[int] = []

    def cancel() -> bool:
        asked.append(1)
        return len(asked) == 2

    with pytest.raises(Cancelled):
        extract(ball, Grid.around(LOW, HIGH, 64), cKDTree(sphere(9)), reach=0.1, cancel=cancel)


@pytest.mark.parametrize("resolution", [16, 17, 40, 100])
def test_the_grid_covers_a_box_of_any_shape(resolution: int) -> None:
    low, high = np.array([-1.0, -0.31, 0.2]), np.array([1.0, 0.3, 0.21])
    grid = Grid.around(low, high, resolution)
    assert grid.cell == pytest.approx(2 / resolution)
    assert (grid.origin <= low + 1e-12).all()
    assert (grid.points(grid.shape) >= high - 1e-12).all()
    assert (grid.shape % 2**grid.levels == 0).all()
