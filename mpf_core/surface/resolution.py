"""How fine the grid must be, from what the samples can show."""

from __future__ import annotations

import numpy as np

from mpf_core.field.footprint import Footprint
from mpf_core.fit.initialize import Initialization
from mpf_core.options import SurfaceOptions

CELLS_PER_SPACING = 3.0  # finer cells than a third of the spacing show the network, not the data
CELLS_PER_SHELL = 3.0  # at two, a shell that the fit left a little thinner is perforated
SHEETS_FROM = 0.9  # share of samples that bound enclosed space below which there are sheets
LOWEST, HIGHEST = 96, 512


def shell_of(start: Initialization | None) -> float | None:
    """Thickness of the thinnest walls: of the shell that the warm start put around open sheets, or
    of a solid's walls closer together than the samples; None where there are neither."""
    if start is None:
        return None
    shell = 2 * start.shell if start.seeded < SHEETS_FROM else np.inf
    thickness = min(shell, start.thinnest)
    return thickness if np.isfinite(thickness) else None


def choose_resolution(options: SurfaceOptions, footprint: Footprint) -> tuple[int, str]:
    """Cells along the longest side (2 in normalised units), and why."""
    if options.resolution is not None:
        return options.resolution, "as asked"
    cell, why = footprint.reach / CELLS_PER_SPACING, "three cells a sample spacing"
    if footprint.thickness is not None and footprint.thickness / CELLS_PER_SHELL < cell:
        cell = footprint.thickness / CELLS_PER_SHELL
        why = "three cells across the thinnest wall or shell"
    wanted = round(2.0 / cell)
    resolution = min(max(wanted, LOWEST), HIGHEST)
    if resolution < wanted:
        why += f", held to {HIGHEST}"
    elif resolution > wanted:
        why += f", raised to {LOWEST}"
    return resolution, why
