"""The grid is chosen from the spacing of the samples and the thickness of the shell."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mpf_core.field.footprint import Footprint
from mpf_core.fit.initialize import Initialization
from mpf_core.options import PRESETS, SurfaceOptions
from mpf_core.quality.topology import topology
from mpf_core.surface.isosurface import Grid, extract
from mpf_core.surface.mesh import Mesh
from mpf_core.surface.resolution import (
    CELLS_PER_SPACING,
    HIGHEST,
    LOWEST,
    Fineness,
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
    assert chosen == Fineness(resolution, (1, 1, 1), "as asked")


def test_solids_get_three_cells_a_spacing() -> None:
    chosen = choose_resolution(AUTO, sampled(0.03, seeded=1.0))
    assert chosen.cells == round(2 * CELLS_PER_SPACING / 0.03)
    assert "three cells" in chosen.reason
    assert choose_resolution(AUTO, sampled(0.03, seeded=None)) == chosen


def test_a_draft_has_time_for_fewer_cells_but_walls_get_theirs() -> None:
    draft = PRESETS["draft"].surface
    chosen = choose_resolution(draft, sampled(0.005, seeded=1.0))
    assert chosen.cells == draft.highest_resolution < HIGHEST
    assert choose_resolution(draft, sampled(0.005, wall=0.006)).cells > draft.highest_resolution


def test_sheets_get_cells_finer_than_their_shell() -> None:
    chosen = choose_resolution(AUTO, sampled(0.03, seeded=0.0))
    assert 2 / chosen.cells <= 0.006 * 1.01
    assert "shell" in chosen.reason


def test_thin_walls_of_solids_get_fine_cells_too() -> None:
    chosen = choose_resolution(AUTO, sampled(0.03, wall=0.015))
    assert 2 / chosen.cells <= 0.005 * 1.01
    assert "wall" in chosen.reason


def test_the_range_is_kept_and_told() -> None:
    assert choose_resolution(AUTO, sampled(0.5, seeded=1.0)).cells == LOWEST
    assert "raised" in choose_resolution(AUTO, sampled(0.5, seeded=1.0)).reason
    assert choose_resolution(AUTO, sampled(1e-4, seeded=1.0)).cells == HIGHEST
    assert "held" in choose_resolution(AUTO, sampled(1e-4, seeded=1.0)).reason


def test_walls_thinner_than_a_cell_get_a_finer_grid_as_far_as_needed() -> None:
    cells = choose_resolution(AUTO, sampled(0.03, wall=0.004)).cells
    assert HIGHEST < cells < 1024
    assert 1.3 * 2.1 / cells < 0.004  # the grid spans the padded box
    assert choose_resolution(AUTO, sampled(0.03, wall=1e-4)).cells == 1024


def plate(thickness: float, turn: NDArray[np.float64]) -> NDArray[np.float64]:
    """Samples of both sides and the rim of a plate that spans the box, turned about its centre."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.7, 0.7, (4000, 3))
    points[:, 2] = rng.choice([-0.5, 0.5], 4000) * thickness
    rotated: NDArray[np.float64] = points @ turn.T
    return rotated


@pytest.mark.parametrize("turned", [False, True], ids=["upright", "turned"])
def test_a_plate_of_five_thousandths_is_closed_and_whole(turned: bool) -> None:
    turn = Rotation.from_euler("xyz", [0.4, 0.3, 0.9]).as_matrix() if turned else np.eye(3)
    thickness, points = 0.005, plate(0.005, turn)

    def field(x: NDArray[np.float64]) -> NDArray[np.float32]:
        q = np.abs(x @ turn) - [0.7, 0.7, thickness / 2]
        outside = np.linalg.norm(np.maximum(q, 0), axis=1)
        return (outside + np.minimum(q.max(1), 0)).astype(np.float32)

    footprint = Footprint.of(points, spacing=0.03, reach=0.03, thickness=thickness)
    chosen = choose_resolution(AUTO, footprint)
    low, high = points.min(0) - 0.05, points.max(0) + 0.05
    grid = Grid.around(low, high, round(chosen.cells * (high - low).max() / 2.1), chosen.finer)
    surface = extract(field, grid, footprint.tree, reach=0.03)
    counted = topology(Mesh(surface.vertices, surface.faces))
    assert counted.watertight
    assert (counted.components, counted.euler_characteristic) == (1, 2)
    if not turned:
        assert chosen.cells < 300
        assert chosen.finer[:2] == (1, 1)
        assert thickness > 2.5 * grid.steps[2]
        assert "finer along z" in chosen.reason
