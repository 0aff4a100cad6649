"""Previews come while the fit goes on, are rare enough, and are never the reason that it ends."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
import pytest
import trimesh

from mpf_core.cloud.pointcloud import PointCloud
from mpf_core.errors import NoSurface
from mpf_core.field import MetricPhaseField
from mpf_core.options import options_from
from mpf_core.pipeline import reconstruct_cloud
from mpf_core.preview import PAUSE, SHARE, Previews
from mpf_core.surface.mesh import Mesh
from mpf_core.watch import Watch
from tests.mpf_core.clouds import sphere

FIELD: Any = None  # what is not drawn is not looked at


class Clock:
    """Moves by `step` at every look, and when told."""

    def __init__(self, step: float = 0.0) -> None:
        self.now, self.step = 0.0, step

    def __call__(self) -> float:
        self.now += self.step
        return self.now


def triangle() -> Mesh:
    corners = np.eye(3)
    return Mesh(corners, np.array([[0, 1, 2]]), np.ones((3, 3)) / np.sqrt(3), None)


@pytest.mark.parametrize("cost", [0.01, 0.5, 4.0])
def test_previews_take_their_share_and_no_more(cost: float) -> None:
    clock = Clock()
    shown: list[float] = []

    def draw(_: MetricPhaseField) -> Mesh:
        clock.now += cost
        return triangle()

    previews = Previews(draw, lambda _: shown.append(clock.now), clock)
    for _ in range(3000):
        clock.now += 0.1
        previews(FIELD)
    assert len(shown) > 1
    assert previews.seconds == pytest.approx(len(shown) * cost)
    assert previews.seconds <= SHARE * clock.now
    assert min(np.diff(shown)) >= PAUSE


def test_a_field_without_a_surface_is_passed_over() -> None:
    clock = Clock(1.0)
    tries = 0

    def draw(_: MetricPhaseField) -> Mesh:
        nonlocal tries
        tries += 1
        raise NoSurface("nothing yet")

    previews = Previews(draw, lambda _: pytest.fail("nothing to show"), clock)
    for _ in range(100):
        previews(FIELD)
    assert tries > 1


def test_a_fit_shows_meshes_in_the_frame_of_its_input() -> None:
    options = options_from(
        {"width": 32, "omega": 5.0, "max_iterations": 100, "resolution": 24, "threads": 1,
         "surface_points": 128, "near_points": 128, "far_points": 128, "start_points": 1024,
         "time_budget": 604_800.0}
    )  # fmt: skip
    shown: list[bytes] = []
    # Every look at this clock is half a second: a preview is due at each report.
    watch = Watch(Clock(0.5), None, None, preview=shown.append)
    cloud = PointCloud(sphere(400, 3.0) + np.array([5.0, 0, 0]), None, None)
    result = reconstruct_cloud(cloud, options, watch)
    assert shown
    mesh: Any = trimesh.load_mesh(io.BytesIO(shown[-1]), file_type="glb", process=False)
    if isinstance(mesh, trimesh.Scene):
        mesh = mesh.to_geometry()
    assert np.abs(mesh.bounds.mean(0) - [5.0, 0, 0]).max() < 1.0
    assert result.report["fit"]["preview_seconds"] > 0
