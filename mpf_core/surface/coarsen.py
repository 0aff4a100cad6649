"""Fewer triangles than the grid made: thin walls need fine cells, their faces do not.

A wall is closed only if cells are a third of its thickness, over its whole area. Triangles that
much finer than the samples' spacing show nothing that the data know, and make every later step
slower.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mpf_core.errors import SurfaceError
from mpf_core.options import SurfaceOptions
from mpf_core.surface.mesh import Mesh
from mpf_core.surface.normals import face_crosses
from mpf_core.surface.simplify import decimated

EDGES_PER_SPACING = 2.5  # of equilateral triangles of the mean size that are left
FEWEST = 20_000  # faces that are always affordable
MOST_OF_ALL = 2_000_000  # for which memory has, in the last step
WORTH = 1.3  # times the wanted number, from which merging pays

Array = NDArray[np.float64]
Faces = NDArray[np.int64]


def coarsened(vertices: Array, faces: Faces, spacing: float, most: int) -> tuple[Array, Faces]:
    """The mesh with as many faces as samples `spacing` apart can describe, at most so many, or as
    it is if it has not many more, or would not stay whole."""
    wanted = wanted_faces(vertices, faces, spacing, most)
    if len(faces) <= WORTH * wanted:
        return vertices, faces
    try:
        return decimated(vertices, faces, wanted)
    except SurfaceError:
        return vertices, faces


def most_faces(options: SurfaceOptions, networks: int = 1) -> int:
    """What many networks hold gets more faces."""
    return min(options.coarsen_to * networks, MOST_OF_ALL)


def wanted_faces(vertices: Array, faces: Faces, spacing: float, most: int) -> int:
    """By the area of the mesh."""
    area = float(np.linalg.norm(face_crosses(Mesh(vertices, faces)), axis=1).sum()) / 2
    return faces_for(area, spacing, most)


def faces_for(area: float, spacing: float, most: int) -> int:
    """How many faces a surface of so much area gets."""
    edge = spacing / EDGES_PER_SPACING
    return int(np.clip(area / (np.sqrt(3) / 4 * edge**2), FEWEST, most))
