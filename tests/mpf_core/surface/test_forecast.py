"""What extraction will cost, told before the fit from the samples alone."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mpf_core.cloud.neighbors import analyse
from mpf_core.field.footprint import Footprint
from mpf_core.options import options_from
from mpf_core.surface import forecast
from mpf_core.surface.forecast import Forecast, Pace, Until
from mpf_core.surface.isosurface import Grid, extract
from tests.mpf_core.clouds import plane, sphere


class Ticking:
    """A clock that an evaluation moves on by a fixed time per point."""

    def __init__(self, pace: float) -> None:
        self.now, self.pace = 0.0, pace

    def evaluate(self, points: NDArray[np.float64]) -> NDArray[np.float32]:
        self.now += self.pace * len(points)
        return (np.linalg.norm(points, axis=1) - 0.8).astype(np.float32)

    def __call__(self) -> float:
        return self.now


def footprint(points: NDArray[np.float64], thickness: float | None = None) -> Footprint:
    spacing = analyse(points).median_spacing
    return Footprint.of(points, spacing=spacing, reach=spacing, thickness=thickness)


def foretold(points: NDArray[np.float64], pace: float = 1e-5, **changes: Any) -> Forecast:
    near = analyse(points)
    area, shadows = forecast.area_of(near, 0.0), forecast.shadows_of(near, 0.0)
    paces = Pace(pace, pace / 2)
    return Forecast(options_from(changes).surface, footprint(points), area, shadows, paces)


def told(points: NDArray[np.float64], pace: float = 1e-5, **changes: Any) -> float:
    found = foretold(points, pace, **changes)
    return found.seconds(found.fineness)


def test_samples_tell_the_area_of_what_they_cover() -> None:
    ball = analyse(sphere(6000))
    assert forecast.area_of(ball, 0.0) == pytest.approx(
        4 * np.pi, rel=0.2
    )  # even samples are closer
    assert forecast.area_of(ball, 1.0) == pytest.approx(2 * forecast.area_of(ball, 0.0))
    flat = analyse(plane(60))
    assert forecast.area_of(flat, 0.0) == pytest.approx(4, rel=0.25)
    assert forecast.shadows_of(flat, 0.0) == pytest.approx((0, 0, 4), rel=0.25, abs=1e-6)
    assert forecast.shadows_of(ball, 1.0) == pytest.approx(np.full(3, 4 * np.pi), rel=0.25)


def test_the_cells_that_a_ball_crosses_are_foretold() -> None:
    """A ball of area 8.04 on a grid of 100."""
    clock = Ticking(0.0)
    points = 0.8 * sphere(4000)
    grid = Grid.around(np.full(3, -1.0), np.full(3, 1.0), 100)
    crossed = extract(clock.evaluate, grid, footprint(points).tree, reach=0.1).crossed_cells
    shadows = forecast.shadows_of(analyse(points), 0.0)
    assert forecast.crossed(shadows, np.full(3, 0.02)) == pytest.approx(crossed, rel=0.25)


def test_flat_cells_make_a_plate_no_dearer_but_its_rim() -> None:
    steps = np.array([0.02, 0.02, 0.005])
    assert forecast.crossed(np.array([0.0, 0.0, 4.0]), steps) == pytest.approx(4 / 0.02**2)
    assert forecast.crossed(np.array([4.0, 0.0, 0.0]), steps) == pytest.approx(4 / 0.02 / 0.005)


def test_time_grows_with_the_pace_and_with_the_square_of_the_resolution() -> None:
    points = 0.8 * sphere(4000)
    few, more = (told(points, resolution=r) - forecast.FIXED for r in (128, 256))
    assert more == pytest.approx(4 * few, rel=1e-6)
    slow = told(points, pace=2e-5, resolution=128) - forecast.FIXED
    assert slow == pytest.approx(2 * few, rel=1e-6)


def test_the_pace_is_the_best_of_what_is_seen() -> None:
    clock = Ticking(3e-6)
    found = forecast.pace_of(clock.evaluate, clock, 1)
    assert found.evaluation == pytest.approx(3e-6)
    assert 0 < forecast.pace_of(clock.evaluate, time.perf_counter, 1).search < 1e-3


def test_a_torn_surface_is_foretold_to_last_longer_than_its_cells() -> None:
    found = foretold(0.8 * sphere(4000), resolution=128)
    cells = found.cells(found.fineness)
    whole, torn = (found.seconds(found.fineness, k * cells) - forecast.FIXED for k in (1.4, 2.8))
    assert torn == pytest.approx(2 * whole * forecast.DEARER)


def test_what_does_not_fit_into_the_time_left_is_told() -> None:
    found = foretold(0.8 * sphere(4000), resolution=128)
    cells = found.cells(found.fineness)
    needed = found.seconds(found.fineness)
    soon, late = (Until(found, lambda: 0.0, share * needed) for share in (0.8, 0.7))
    assert soon.fits(found.fineness, cells) and not late.fits(found.fineness, cells)
    assert not soon.fits(found.fineness, 2 * cells)
    after = forecast.AFTER * found.pace.search * 1000
    assert late.last_step(1000) == pytest.approx(0.7 * needed + forecast.GRACE - after)
