"""The grid is chosen from the spacing of the samples and the thickness of the shell."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from mpf_core.field.footprint import Footprint
from mpf_core.fit.initialize import Initialization
from mpf_core.options import SurfaceOptions
from mpf_core.surface.resolution import (
    CELLS_PER_SPACING,
    HIGHEST,
    LOWEST,
    choose_resolution,
    shell_of,
)

AUTO = SurfaceOptions()


def sampled(
    reach: float, *, seeded: float | None = 1.0, shell: float = 0.006, wall: float = np.inf
) -> Footprint:
    """Of a cloud of which the share `seeded` encloses space; None: there was no warm start."""
    told = SimpleNamespace(seeded=seeded, shell=shell, thinnest=wall)
    start = None if seeded is None else told
    thickness = shell_of(cast(Initialization | None, start))
    return Footprint.of(np.zeros((1, 3)), spacing=reach, reach=reach, thickness=thickness)


@pytest.mark.parametrize("resolution", [16, 333, 2048])
def test_what_is_asked_for_is_taken(resolution: int) -> None:
    chosen = choose_resolution(SurfaceOptions(resolution=resolution), sampled(0.5, seeded=0.0))
    assert chosen == (resolution, "as asked")


def test_solids_get_three_cells_a_spacing() -> None:
    resolution, why = choose_resolution(AUTO, sampled(0.03, seeded=1.0))
    assert resolution == round(2 * CELLS_PER_SPACING / 0.03)
    assert "three cells" in why
    assert choose_resolution(AUTO, sampled(0.03, seeded=None)) == (resolution, why)


def test_sheets_get_cells_finer_than_their_shell() -> None:
    resolution, why = choose_resolution(AUTO, sampled(0.03, seeded=0.0))
    assert 2 / resolution <= 0.006 * 1.01
    assert "shell" in why


def test_thin_walls_of_solids_get_fine_cells_too() -> None:
    resolution, why = choose_resolution(AUTO, sampled(0.03, wall=0.015))
    assert 2 / resolution <= 0.005 * 1.01
    assert "wall" in why


def test_the_range_is_kept_and_told() -> None:
    assert choose_resolution(AUTO, sampled(0.5, seeded=1.0))[0] == LOWEST
    assert "raised" in choose_resolution(AUTO, sampled(0.5, seeded=1.0))[1]
    assert choose_resolution(AUTO, sampled(1e-4, seeded=1.0))[0] == HIGHEST
    assert "held" in choose_resolution(AUTO, sampled(1e-4, seeded=1.0))[1]
