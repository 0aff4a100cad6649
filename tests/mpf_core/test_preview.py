"""Previews come while the fit goes on, are rare enough, and are never the reason that it ends."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from mpf_core.errors import NoSurface
from mpf_core.field import MetricPhaseField
from mpf_core.preview import PAUSE, SHARE, Previews
from mpf_core.surface.mesh import Mesh

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
