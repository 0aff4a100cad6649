"""Classical starts of a few shapes, made once for all tests of the fit."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

from mpf_core.cloud.neighbors import Neighborhoods, analyse
from mpf_core.fit.freespace import FreeSpace, flood
from mpf_core.fit.initialize import Initialization, initialize
from tests.mpf_core.clouds import Array, plane, sphere

RADIUS = 0.9


def cloud(kind: str) -> Array:
    whole = sphere(3000, RADIUS)
    # A cap of half angle 15° is 1.7 % of the sphere; its mouth is wider than the discs.
    kinds = {
        "sphere": whole,
        "hemisphere": whole[whole[:, 2] > 0],
        "gap": whole[whole[:, 2] < RADIUS * np.cos(np.radians(15))],
        "plane": plane(40, 0.2) * RADIUS,
    }
    return kinds[kind]


@cache
def neighbours_of(kind: str) -> Neighborhoods:
    return analyse(cloud(kind), threads=1)


@cache
def flood_of(kind: str) -> FreeSpace:
    return flood(neighbours_of(kind))


@cache
def start_of(kind: str) -> Initialization:
    return initialize(neighbours_of(kind), threads=1)


@pytest.fixture
def neighbours() -> Callable[[str], Neighborhoods]:
    return neighbours_of


@pytest.fixture
def start() -> Callable[[str], Initialization]:
    return start_of


@pytest.fixture
def flooded() -> Callable[[str], FreeSpace]:
    return flood_of
