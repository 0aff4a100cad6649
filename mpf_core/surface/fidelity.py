"""The last step: vertices of the extracted mesh move onto the locally fitted data.

Solids move along the normal onto the surface through the samples; of the shell around an open
sheet, the wall that passes through the samples moves onto them and the other to a thin, even
distance behind. Triangles stay as they are, so nothing loses its manifoldness; where a triangle
would fold over or cross another, its vertices stay back. Noise limits the step: what the samples'
scatter cannot tell from the field's own surface is left to the field.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpf_core.cloud.neighbors import Neighborhoods
from mpf_core.cloud.normalize import Similarity
from mpf_core.fit.initialize import Initialization
from mpf_core.fit.sides import Sides
from mpf_core.heeding import Late, no_later
from mpf_core.options import DataOptions
from mpf_core.progress import Clock
from mpf_core.surface.aim import Aim, aim_at
from mpf_core.surface.following import Data, Moved, follow
from mpf_core.surface.mesh import Mesh
from mpf_core.surface.patches import patches_of
from mpf_core.surface.takeback import MOST_FACES

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

# A mesh of 900 000 faces took 45 to 55 s on a busy machine, which no preset's time has room for.
# What `coarsen` leaves, WORTH times the default of `coarsen_to`, has fewer vertices: half of its
# faces.
MOST_VERTICES = MOST_FACES // 2


def onto_data(
    mesh: Mesh,
    similarity: Similarity,
    start: Initialization | None,
    options: DataOptions,
    *,
    spacing: float,
    threads: int = -1,
    clock: Clock = time.monotonic,
    end: float = np.inf,
) -> tuple[Mesh, dict[str, Any]]:
    """`mesh`, in the input's frame, moved onto the data, and what the report tells of that.

    `spacing` is the cloud's, normalised: the thickness of shells is a share of it. What is not done
    by `end` is not done at all.
    """
    if options.fidelity == "off":
        return mesh, {"applied": False, "reason": "switched off"}
    if start is None:
        return mesh, {"applied": False, "reason": "there is no local fit without a warm start"}
    if len(mesh.vertices) > MOST_VERTICES:
        return mesh, {"applied": False, "reason": f"more than {MOST_VERTICES} vertices"}
    assert mesh.normals is not None
    begin = clock()
    try:
        with no_later(clock, end):
            moved = follow_data(
                similarity.to_normalised(mesh.vertices),
                mesh.faces,
                mesh.normals,
                start.local.neighbours,
                start.normals,
                sheets_of(start.bounds),
                shell=2 * start.shell,
                thickness=options.sheet_thickness * spacing,
                threads=threads,
            )
    except Late:
        return mesh, {"applied": False, "reason": "there was no time left for it"}
    return taken(mesh, moved, similarity, clock() - begin)


def taken(
    mesh: Mesh, moved: Moved, similarity: Similarity, seconds: float
) -> tuple[Mesh, dict[str, Any]]:
    """`mesh`, in the input's frame, where it `moved` to, and what the report tells of that."""
    length = similarity.length_to_input
    report: dict[str, Any] = {
        "applied": moved.applied,
        "reason": "" if moved.applied else "the data say no more than the field, given their noise",
        "share_of_the_way": round(moved.gain, 4),
        "mean_displacement": length(moved.mean),
        "max_displacement": length(moved.largest),
        "bandwidth": length(moved.bandwidth),
        "standard_error": length(moved.deviation),
        "faces_taken_back": moved.taken_back,
        "thickness": None,
        "seconds": round(seconds, 3),
    }
    if moved.thickness is not None:
        median, least = moved.thickness
        report["thickness"] = {"median": length(median), "min": length(least)}
    if not moved.applied:
        return mesh, report
    vertices = similarity.to_input(moved.vertices)
    return replace(mesh, vertices=vertices, normals=moved.normals), report


def follow_data(
    vertices: Array,
    faces: Indices,
    directions: Array,
    cloud: Neighborhoods,
    normals: Array,
    sheet: NDArray[np.int8],
    *,
    shell: float,
    thickness: float,
    threads: int = -1,
) -> Moved:
    """Move `vertices` (v, 3) with unit outward `directions` (v, 3) onto the data.

    The data are the samples of `cloud` with their oriented `normals` (n, 3) and what each is of,
    `sheet` (n,) as `sheets_of` has it; `shell` is the thickness that the field was given around
    sheets, `thickness` what they are to have.
    """
    patches = patches_of(cloud, normals, sheet, thickness, threads)
    data = Data(patches.deviation, patches.kernel * cloud.median_spacing, shell)

    def aim_of(x: Array) -> Aim:
        return aim_at(patches, x, directions, threads)

    return follow(vertices, faces, directions, aim_of, data, threads)


def sheets_of(bounds: Sides) -> NDArray[np.int8]:
    """(n,) 1 for samples of sheets in free space, −1 for those inside a solid, 0 for solids."""
    free = 1 - bounds.solid - bounds.buried
    most = np.argmax([bounds.solid, free, bounds.buried], axis=0)
    kinds: NDArray[np.int8] = np.array([0, 1, -1], np.int8)[most]
    return kinds
