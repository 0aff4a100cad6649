"""The mesh as its user wants it: of one layer, smoother, with fewer faces."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mpf_core.cloud.neighbors import analyse
from mpf_core.field.fitted import Fitted
from mpf_core.fit.initialize import Initialization, initialize
from mpf_core.options import SurfaceOptions
from mpf_core.surface.finish import blended
from mpf_core.surface.mesh import Mesh
from mpf_core.surface.normals import vertex_normals
from mpf_core.surface.sheet import single_layer
from mpf_core.surface.simplify import decimated, deviation, taubin
from mpf_core.surface.uncross import uncrossed

Array = NDArray[np.float64]
Faces = NDArray[np.int64]


@dataclass(frozen=True)
class Edited:
    """The mesh in the input's frame, and what the report tells.

    edits: what smoothing and decimation moved; double_cover: of a surface of one layer, see
    `SingleLayer`; None where shells were left
    """

    mesh: Mesh
    edits: dict[str, Any]
    double_cover: dict[str, Any] | None = None


def edited(
    mesh: Mesh,
    options: SurfaceOptions,
    fitted: Fitted,
    start: Initialization | None = None,
) -> Edited:
    """`mesh`, in the input's frame, after all that `options` ask for.

    start: the samples' normals and local fit, made from those that the field keeps where needed
    and not given. Pairs of faces that cross since decimation are parted. New vertices get the
    triangles' normals and the colours of the vertices around. Raises NoSurface, SurfaceError.
    """
    double_cover: dict[str, Any] | None = None
    edits: dict[str, Any] = {}
    similarity = fitted.similarity
    whole = similarity.to_normalised(mesh.vertices)
    vertices, faces = whole, mesh.faces
    unit = similarity.length_to_input(1.0)
    if options.surface_kind == "sheet":
        layer = single_layer(vertices, faces, start or initialize(analyse(fitted.footprint.points)))
        vertices, faces = layer.vertices, layer.faces
        double_cover = layer.as_dict(similarity)
    if options.smoothing:
        before = vertices
        vertices = taubin(vertices, faces, options.smoothing)
        edits["smoothing"] = {"rounds": options.smoothing}
        edits["smoothing"] |= _moved(
            (before, faces), (vertices, faces), similarity.length_to_input(1.0)
        )
    if options.max_faces is not None and len(faces) > options.max_faces:
        fine = vertices, faces
        vertices, faces = decimated(vertices, faces, options.max_faces)
        vertices = uncrossed(Mesh(vertices, faces), Mesh(*fine))
        edits["decimation"] = {"faces_before": len(fine[1]), "faces": len(faces)}
        edits["decimation"] |= _moved(fine, (vertices, faces), unit)
    if vertices is whole:
        return Edited(mesh, edits, double_cover)
    made = Mesh(similarity.to_input(vertices), faces)
    colors = None if mesh.colors is None else blended(vertices, cKDTree(whole), mesh.colors)
    return Edited(replace(made, normals=vertex_normals(made), colors=colors), edits, double_cover)


def _moved(
    before: tuple[Array, Faces], after: tuple[Array, Faces], unit: float
) -> dict[str, float]:
    """How far the surface moved; `unit` is the normalised frame's in the input's."""
    found = deviation(before, after)
    return {"mean_distance": unit * found.mean, "largest_distance": unit * found.largest}
