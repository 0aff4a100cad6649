"""How fine the grid must be, from what the samples can show."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mpf_core.field.footprint import Footprint
from mpf_core.fit.initialize import Initialization
from mpf_core.options import LOWEST_RESOLUTION, SurfaceOptions

CELLS_PER_SPACING = 3.0  # finer cells than a third of the spacing show the network, not the data
CELLS_PER_SHELL = 3.0  # at two, a shell that the fit left a little thinner is perforated
SHEETS_FROM = 0.97  # share of samples that bound enclosed space below which there are sheets
LOWEST = LOWEST_RESOLUTION
HIGHEST = 512  # that thin walls get whatever `highest_resolution` says
# Walls thinner than a cell are perforated. For them, and no further, the grid may be finer.
LEAST_PER_WALL, HIGHEST_OF_ALL = 1.4, 1024
FLAT = 0.02  # of the longest extent: along a shorter one, cells are made finer by themselves
MOST_FINER = 16


@dataclass(frozen=True)
class Fineness:
    """cells: along the longest side (2 in normalised units); finer: how many times finer they are
    along x, y and z; reason: why, for the report."""

    cells: int
    finer: tuple[int, int, int]
    reason: str


def shell_of(start: Initialization | None) -> float | None:
    """Thickness of the thinnest walls: of the shell that the warm start put around open sheets, or
    of a solid's walls closer together than the samples; None where there are neither."""
    if start is None:
        return None
    shell = 2 * start.shell if start.seeded < SHEETS_FROM else np.inf
    thickness = min(shell, start.thinnest)
    return thickness if np.isfinite(thickness) else None


def choose_resolution(options: SurfaceOptions, footprint: Footprint, networks: int = 1) -> Fineness:
    """How fine the grid must be for these samples and walls, and why; a surface of so many networks
    has detail for as many times more cells."""
    flat = _flat_axes(footprint)
    if options.resolution is not None:
        cells, why = options.resolution, "as asked"
    else:
        thickness = None if flat.any() else footprint.thickness
        cells, why = _cells(footprint.reach, thickness, options.highest_resolution, networks)
    finer = np.ones(3, dtype=np.int64)
    for axis in np.flatnonzero(flat):
        across = footprint.thickness or max(_extents(footprint)[axis], 1e-9)
        wanted = np.ceil(CELLS_PER_SHELL * 2.0 / cells / across)
        finer[axis] = np.clip(wanted, 1, MOST_FINER)
    for axis in np.flatnonzero(finer > 1):
        why += f"; {finer[axis]} times finer along {'xyz'[axis]}, where all is thin"
    return Fineness(cells, (int(finer[0]), int(finer[1]), int(finer[2])), why)


def _cells(spacing: float, thickness: float | None, highest: int, networks: int) -> tuple[int, str]:
    """For the samples, or for the thinnest wall or shell if that asks for more."""
    most = min(round(highest * networks**0.5), HIGHEST_OF_ALL)
    found = _held(2.0 * CELLS_PER_SPACING / spacing, most, "three cells a sample spacing")
    if thickness is not None:
        most = min(round(max(highest, HIGHEST) * networks**0.5), HIGHEST_OF_ALL)
        most = min(max(most, round(2.0 * LEAST_PER_WALL / thickness)), HIGHEST_OF_ALL)
        across = 2.0 * CELLS_PER_SHELL / thickness
        wall = _held(across, most, "three cells across the thinnest wall or shell")
        found = max(found, wall, key=lambda one: one[0])
    return found


def _held(wanted: float, highest: int, why: str) -> tuple[int, str]:
    cells = min(max(round(wanted), LOWEST), highest)
    if cells < round(wanted):
        why += f", held to {highest}"
    elif cells > round(wanted):
        why += f", raised to {LOWEST}"
    return cells, why


def _extents(footprint: Footprint) -> NDArray[np.float64]:
    extents: NDArray[np.float64] = np.ptp(footprint.points, axis=0)
    return extents


def _flat_axes(footprint: Footprint) -> NDArray[np.bool_]:
    """(3,) axes along which the whole cloud is one thin wall."""
    extents = _extents(footprint)
    flat: NDArray[np.bool_] = extents < FLAT * extents.max()
    return flat
