"""Surfaces that bulge out of the box of the fit end at its side, closed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mpf_core.cloud.normalize import Similarity
from mpf_core.field import MetricPhaseField
from mpf_core.field.fitted import FittedField
from mpf_core.field.footprint import Footprint
from mpf_core.options import SurfaceOptions
from mpf_core.quality.topology import topology
from mpf_core.surface.boxed import kept_within, leaves, negative_share
from mpf_core.surface.extraction import extract_mesh
from mpf_core.surface.isosurface import Grid, extract
from mpf_core.surface.lattice import Evaluate
from mpf_core.surface.mesh import Mesh
from tests.mpf_core.clouds import sphere

GRID = Grid.around(np.full(3, -0.8), np.full(3, 0.8), 48)
TREE = cKDTree(sphere(500, 0.5))


def ball(radius: float, sign: int = 1) -> Evaluate:
    def level(x: NDArray[np.float64]) -> NDArray[np.float32]:
        return sign * (np.linalg.norm(x - [0, 0, 0.25], axis=1) - radius).astype(np.float32)

    return level


@pytest.mark.parametrize("sign", [1, -1])
def test_a_bulge_through_a_side_is_closed_there(sign: int) -> None:
    level = ball(0.6, sign)
    open_ = extract(level, GRID, TREE, reach=0.05)
    assert leaves(open_)
    within = kept_within(level, GRID, negative_share(level, GRID))
    assert within is not None
    closed = extract(within, GRID, TREE, reach=0.05)
    found = topology(Mesh(closed.vertices, closed.faces))
    assert (found.boundary_edges, found.components, found.euler_characteristic) == (0, 1, 2)
    inside = np.linalg.norm(closed.vertices - [0, 0, 0.25], axis=1)
    assert inside.max() < 0.601
    assert not leaves(closed)


@dataclass(frozen=True)
class Ball(FittedField):
    """A field whose surface is that of a ball."""

    radius: float = 0.6

    def level(self) -> Evaluate:
        return ball(self.radius)


@pytest.mark.parametrize(("radius", "ended"), [(0.6, True), (0.4, False)])
def test_the_report_tells_of_the_cut(radius: float, ended: bool) -> None:
    footprint = Footprint.of(sphere(500, 0.5), spacing=0.05, reach=0.05, thickness=None)
    box = np.array([np.full(3, -0.8), np.full(3, 0.8)])
    field = Ball(MetricPhaseField(width=8), Similarity(np.zeros(3), 1.0), box, footprint, radius)
    options = SurfaceOptions(resolution=48)
    found = extract_mesh(field, options)
    assert found.report["ended_at_sides"] is ended
    assert topology(found.mesh).boundary_edges == 0


def test_a_surface_that_keeps_to_the_box_is_left_alone() -> None:
    assert not leaves(extract(ball(0.4), GRID, TREE, reach=0.05))


def test_a_sheet_that_parts_the_box_is_not_an_accident() -> None:
    def level(x: NDArray[np.float64]) -> NDArray[np.float32]:
        return x[:, 2].astype(np.float32)

    assert kept_within(level, GRID, negative_share(level, GRID)) is None
