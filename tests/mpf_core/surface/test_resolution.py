"""The grid is chosen from the spacing of the samples and the thickness of the shell."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import pytest

from mpf_core.cloud.neighbors import Neighborhoods, analyse
from mpf_core.fit.initialize import Initialization
from mpf_core.options import SurfaceOptions
from mpf_core.surface.resolution import CELLS_PER_SPACING, HIGHEST, LOWEST, choose_resolution
from tests.mpf_core.clouds import sphere

AUTO = SurfaceOptions()


def spaced(spacing: float) -> Neighborhoods:
    cloud = analyse(sphere(60), threads=1)
    return replace(cloud, spacing=cloud.spacing * 0 + spacing)


def start(seeded: float, shell: float = 0.006) -> Initialization:
    return cast(Initialization, SimpleNamespace(seeded=seeded, shell=shell))


@pytest.mark.parametrize("resolution", [16, 333, 2048])
def test_what_is_asked_for_is_taken(resolution: int) -> None:
    chosen = choose_resolution(SurfaceOptions(resolution=resolution), spaced(0.5), start(0.0))
    assert chosen == (resolution, "as asked")


def test_solids_get_three_cells_a_spacing() -> None:
    resolution, why = choose_resolution(AUTO, spaced(0.03), start(1.0))
    assert resolution == round(2 * CELLS_PER_SPACING / 0.03)
    assert "three cells" in why
    assert choose_resolution(AUTO, spaced(0.03), None) == (resolution, why)


def test_sheets_get_cells_finer_than_their_shell() -> None:
    resolution, why = choose_resolution(AUTO, spaced(0.03), start(0.0))
    assert 2 / resolution <= 0.006 * 1.01
    assert "shell" in why


def test_the_range_is_kept_and_told() -> None:
    assert choose_resolution(AUTO, spaced(0.5), start(1.0))[0] == LOWEST
    assert "raised" in choose_resolution(AUTO, spaced(0.5), start(1.0))[1]
    assert choose_resolution(AUTO, spaced(1e-4), start(1.0))[0] == HIGHEST
    assert "held" in choose_resolution(AUTO, spaced(1e-4), start(1.0))[1]
