"""Coarse meshes of a field while it is fitted, at no more than a small share of the fit's time."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mpf_core.cloud.neighbors import Neighborhoods
from mpf_core.cloud.normalize import Similarity
from mpf_core.errors import SurfaceError
from mpf_core.field import MetricPhaseField
from mpf_core.field.fitted import gradient_of, theta_of
from mpf_core.progress import CancelCheck, Clock, PreviewCallback
from mpf_core.surface.export import glb_bytes
from mpf_core.surface.finish import finish
from mpf_core.surface.isosurface import Grid, extract
from mpf_core.surface.mesh import Mesh

RESOLUTION = 64  # cells along the longest side: a shape to recognise, in a few tenths of a second
SHARE = 0.05  # of the time since the fit began, at most
PAUSE = 3.0  # s between the starts of two previews
FIRST_COST = 0.3  # s, for as long as none has been timed


class Previews:
    """Shown the field now and then (`Snapshot` of the trainer), it decides when to draw it.

    draw: a coarse mesh of the field in the input's frame; show: takes it as GLB. A field that has
    no surface yet is passed over.
    """

    def __init__(
        self,
        draw: Callable[[MetricPhaseField], Mesh],
        show: PreviewCallback,
        clock: Clock,
    ):
        self._draw, self._show, self._clock = draw, show, clock
        self._begin = clock()
        self._drawn_at = self._begin
        self._cost = FIRST_COST
        self.seconds = 0.0
        """Spent so far."""

    def __call__(self, field: MetricPhaseField) -> None:
        """Draw and show the field, if there is time for it."""
        now = self._clock()
        if now - self._drawn_at < PAUSE:
            return
        if self.seconds + self._cost > SHARE * (now - self._begin):
            return
        try:
            self._show(glb_bytes(self._draw(field), name="preview"))
        except SurfaceError:
            pass  # no surface yet
        finally:
            self._drawn_at, self._cost = now, self._clock() - now
            self.seconds += self._cost


def coarse_mesh(
    neighbours: Neighborhoods,
    box: NDArray[np.float64],
    similarity: Similarity,
    colors: tuple[cKDTree, NDArray[np.uint8]] | None,
    cancel: CancelCheck | None,
    field: MetricPhaseField,
) -> Mesh:
    """The zero level inside `box` as it is now, floaters and all; raises SurfaceError if empty."""
    grid = Grid.around(box[0], box[1], RESOLUTION)
    reach = neighbours.median_spacing
    surface = extract(theta_of(field), grid, neighbours.tree, reach=reach, cancel=cancel)
    return finish(surface.vertices, surface.faces, gradient_of(field), similarity, colors)
