"""From a fitted field to a mesh: in the run that fitted it and, from its file, later."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mpf_core.errors import ResolutionTooHigh
from mpf_core.field.fitted import Fitted
from mpf_core.heeding import Late, no_later
from mpf_core.options import SurfaceOptions
from mpf_core.surface.bounds import BOUND
from mpf_core.surface.boxed import kept_within, leaves, negative_share
from mpf_core.surface.coarsen import coarsened, most_faces
from mpf_core.surface.finish import FLOATER_SPACINGS, finish, without_floaters
from mpf_core.surface.forecast import Until
from mpf_core.surface.isosurface import Fits, Grid, Isosurface, TooManyCells, extract
from mpf_core.surface.lattice import Evaluate
from mpf_core.surface.mesh import Mesh
from mpf_core.surface.perforations import without_perforations
from mpf_core.surface.resolution import LOWEST, Fineness, choose_resolution
from mpf_core.surface.untangle import untangled

CLOSING = 0.4  # of the time left, for perforations

Painted = tuple[cKDTree, NDArray[np.uint8]]


@dataclass(frozen=True)
class Extraction:
    """A mesh in the input's frame, and what the report tells of how it was taken."""

    mesh: Mesh
    report: dict[str, Any]


def extract_mesh(
    fitted: Fitted,
    options: SurfaceOptions,
    *,
    painted: Painted | None = None,
    until: Until | None = None,
) -> Extraction:
    """The zero level of the field as a mesh, on the threads of the caller's `parallel.workers`.

    The same field gives the same mesh bit for bit on the same number of threads. Pairs of faces
    that cross are parted where they can be.
    painted: normalised samples with their colours; the footprint's if not given. until: the grid is
    coarser where there is no time for what the surface turns out to be, and the report says so.
    Raises NoSurface, ResolutionTooHigh, and what the caller's `heeding` does.
    """
    footprint = fitted.footprint
    fineness = choose_resolution(options, footprint, fitted.networks)
    asked = options.resolution is not None
    surface, fineness = _zero_level(fitted, fineness, asked, until)
    kept_apart = max(footprint.spacing, footprint.cover / np.sqrt(3))
    surface, perforations = _closed(surface, footprint.tree, kept_apart, until)
    # A piece is a floater by its distance to the samples, of which the footprint keeps some.
    spacing = footprint.spacing + footprint.cover / FLOATER_SPACINGS
    vertices, faces, floaters = without_floaters(
        surface, footprint.tree, spacing, least=options.min_component
    )
    fine = len(faces)
    if options.coarsen == "auto" and not asked:
        most = most_faces(options, fitted.networks)
        vertices, faces = coarsened(vertices, faces, footprint.spacing, most)
    vertices, untangled_faces = untangled(vertices, faces)
    if painted is None and footprint.colors is not None:
        painted = footprint.tree, footprint.colors
    mesh = finish(vertices, faces, fitted.gradient(), fitted.similarity, painted)
    report = {
        "resolution": fineness.cells,
        "finer": list(fineness.finer),
        "reason": fineness.reason,
        "cell": fitted.similarity.length_to_input(surface.grid.cell),
        "evaluations": surface.evaluations,
        "crossed_cells": surface.crossed_cells,
        "ended_at_sides": surface.ended_at_sides,
        "perforations_closed": perforations,
        "floaters_removed": floaters,
        "faces_untangled": untangled_faces,
        "faces_of_grid": fine,
        "bound": BOUND,
    }
    return Extraction(mesh, report)


def _closed(
    surface: Isosurface, samples: cKDTree, apart: float, until: Until | None
) -> tuple[Isosurface, int | None]:
    """Without perforations, and how many there were; as it is, and None, where closing them takes
    too long, as in shells that the fit has torn."""
    try:
        with nullcontext() if until is None else no_later(until.clock, until.after(CLOSING)):
            vertices, faces, closed = without_perforations(
                surface.vertices, surface.faces, samples, apart
            )
    except Late:
        return surface, None
    return replace(surface, vertices=vertices, faces=faces), closed


def _in_grid(
    level: Evaluate, grid: Grid, samples: cKDTree, reach: float, fits: Fits | None
) -> Isosurface:
    """The zero level, closed at the grid's sides where it leaves the grid and outside is told."""
    share = negative_share(level, grid)
    within = kept_within(level, grid, share)
    # Where the sides' probes tell of it, there is no need to extract it first as it is.
    if within is not None and 0 < share < 1:
        surface = extract(within, grid, samples, reach=reach, fits=fits)
        return replace(surface, ended_at_sides=True)
    surface = extract(level, grid, samples, reach=reach, fits=fits)
    if within is None or not leaves(surface):
        return surface
    closed = extract(within, grid, samples, reach=reach)
    evaluations = surface.evaluations + closed.evaluations
    return replace(closed, evaluations=evaluations, ended_at_sides=True)


def _zero_level(
    fitted: Fitted, fineness: Fineness, asked: bool, until: Until | None
) -> tuple[Isosurface, Fineness]:
    footprint = fitted.footprint
    reach = footprint.reach + footprint.cover
    wanted = fineness.cells
    while True:
        grid = Grid.around(fitted.box[0], fitted.box[1], fineness.cells, fineness.finer)
        fits = None
        if until is not None and not asked and fineness.cells > LOWEST:
            fits = partial(until.fits, fineness)
        try:
            surface = _in_grid(fitted.level(), grid, footprint.tree, reach, fits)
        except TooManyCells as error:
            assert until is not None
            cells = _in_time(fineness, error.cells, until)
            why = f"{cells} cells instead of {wanted}, for which there was no time left"
            fineness = replace(fineness, cells=cells, reason=why)
        except ResolutionTooHigh:
            if asked:
                raise
            # Chosen by us: a coarser surface beats none.
            fineness = replace(fineness, cells=fineness.cells * 3 // 4)
        else:
            return surface, fineness


def _in_time(fineness: Fineness, crossed: float, until: Until) -> int:
    """Cells of the finest grid for which there is time, of a surface that crosses so many of
    this one's."""
    while not until.fits(fineness, crossed) and fineness.cells > LOWEST:
        fewer = max(fineness.cells * 3 // 4, LOWEST)
        crossed *= (fewer / fineness.cells) ** 2
        fineness = replace(fineness, cells=fewer)
    return fineness.cells
