"""The last step: vertices of the extracted mesh move onto the locally fitted data.

Solids move along the normal onto the surface through the samples; of the shell around an open
sheet, the wall that passes through the samples moves onto them and the other to a thin, even
distance behind. Triangles stay as they are, so nothing loses its manifoldness; where a triangle
would fold over or cross another, its vertices stay back. Noise limits the step: what the samples'
scatter cannot tell from the field's own surface is left to the field.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import igl
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mpf_core.cloud.neighbors import Neighborhoods, nearest
from mpf_core.cloud.normalize import Similarity
from mpf_core.fit.initialize import Initialization
from mpf_core.fit.sides import Sides
from mpf_core.heeding import Late, in_parts, no_later
from mpf_core.options import DataOptions
from mpf_core.progress import Clock
from mpf_core.surface.mesh import Mesh
from mpf_core.surface.normals import unit_normals
from mpf_core.surface.patches import NEIGHBOURS, Patches, patches_of, pull
from mpf_core.surface.takeback import MOST_FACES, Motion, allowed_share

STEPS = 2  # moves onto the surface; the second is already a tenth of the first
ROUNDS = 2  # a third gains a tenth of what the second does
FARTHEST = (
    1.0  # local spacings that a vertex moves in a round, and thicknesses of the field's shell
)
SETTLED = 0.99  # trust from which a vertex is taken to reach the data
LEAST_GAIN = 0.1  # of the step's length justified by the data, below which it is not taken
PROBES = 20_000  # vertices at which the thickness is measured

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


# A mesh of 900 000 faces took 45 to 55 s on a busy machine, which no preset's time has room for.
# What `coarsen` leaves, WORTH times the default of `coarsen_to`, has fewer vertices: half of its
# faces.
MOST_VERTICES = MOST_FACES // 2


@dataclass(frozen=True)
class Moved:
    """The mesh after the step, normalised, and what the report tells of it; lengths normalised.

    vertices, normals: (v, 3). gain: share of the way to the data that was gone; bandwidth,
    deviation: kernel and standard error of the local fit; mean, largest: displacements;
    taken_back: faces whose vertices went less far than the rest so that nothing folds or crosses;
    thickness: median and least distance between the walls of shells, None without them.
    """

    vertices: Array
    normals: Array
    applied: bool
    gain: float
    bandwidth: float
    deviation: float
    mean: float
    largest: float
    taken_back: int
    thickness: tuple[float, float] | None


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


@dataclass(frozen=True)
class Data:
    """Of the local fits: `deviation`, standard error; `bandwidth` of the kernel. `shell`: thickness
    that the field was given around sheets."""

    deviation: float
    bandwidth: float
    shell: float


def follow(
    vertices: Array,
    faces: Indices,
    directions: Array,
    aim_of: Callable[[Array], Aim],
    data: Data,
    threads: int = -1,
) -> Moved:
    """Move `vertices` (v, 3) as far towards their aim as noise and triangles allow; `aim_of` says
    where that is from other places (v, 3).

    What has to stay back is given another round from where all then are: the others have made way,
    and a second wall sees its own data from near. None goes farther then than it had left: beside a
    seam, data seen from elsewhere lead off. Raises Late if the first round is.
    """
    way = np.full(len(vertices), np.inf)
    last = _round(vertices, faces, aim_of(vertices), way, data, threads)
    gain, share = last.gain, last.share
    for _ in range(ROUNDS - 1):
        if (last.share == 1).all():
            break
        try:
            last = _round(last.vertices, faces, aim_of(last.vertices), last.left, data, threads)
        except Late:
            break
        share = 1 - (1 - share) * (1 - last.share)
    length = np.linalg.norm(last.vertices - vertices, axis=1)
    return Moved(
        vertices=last.vertices,
        normals=_normals(last.aim, gain * share, directions),
        applied=bool(length.any()),
        gain=gain,
        bandwidth=data.bandwidth,
        deviation=data.deviation,
        mean=float(length.mean()),
        largest=float(length.max()),
        taken_back=int((last.share < 1)[faces].any(1).sum()),
        thickness=_thickness(last.vertices, faces, last.aim.front),
    )


@dataclass(frozen=True)
class Round:
    """Where the vertices (v, 3) have come to, the `aim` they had, the `gain` that the data's noise
    left, the `share` (v,) that triangles left of a step, and the length (v,) that is `left`."""

    vertices: Array
    aim: Aim
    gain: float
    share: Array
    left: Array


def _round(
    vertices: Array, faces: Indices, aim: Aim, most: Array, data: Data, threads: int
) -> Round:
    """One round, in which each vertex goes `most` (v,) at most."""
    gain = _gain(aim, data.deviation)
    step = _shared(aim, vertices, gain, threads) if gain < 1 else aim.step.copy()
    length = np.linalg.norm(step, axis=1)
    reach = np.minimum(FARTHEST * np.maximum(aim.spacing, data.shell), most)
    step *= np.minimum(1.0, reach / np.maximum(length, 1e-300))[:, None]
    if gain < LEAST_GAIN and not aim.back.any():
        step[:] = 0.0
    settled = (aim.trust > SETTLED) & (length <= reach)
    motion = Motion(vertices, faces, step, aim.outward, settled, aim.back)
    share = allowed_share(motion) if step.any() else np.ones(len(vertices))
    left = length - share * np.minimum(length, reach)
    return Round(motion.at(share).vertices, aim, gain, share, left)


def sheets_of(bounds: Sides) -> NDArray[np.int8]:
    """(n,) 1 for samples of sheets in free space, −1 for those inside a solid, 0 for solids."""
    free = 1 - bounds.solid - bounds.buried
    most = np.argmax([bounds.solid, free, bounds.buried], axis=0)
    kinds: NDArray[np.int8] = np.array([0, 1, -1], np.int8)[most]
    return kinds


@dataclass(frozen=True)
class Aim:
    """Where the data want the vertices: step (v, 3), already weighted by trust; outward (v, 3);
    front, trust, offset, spacing: (v,); back: (v,) bool, of the second wall of a shell."""

    step: Array
    outward: Array
    front: Array
    trust: Array
    offset: Array
    spacing: Array

    @property
    def back(self) -> NDArray[np.bool_]:
        return np.asarray(self.front < 0.5)


def aim_at(patches: Patches, vertices: Array, directions: Array, threads: int = -1) -> Aim:
    """Where the patches want vertices (v, 3) with unit outward directions (v, 3)."""
    count = len(vertices)
    step, outward = np.empty((count, 3)), np.empty((count, 3))
    front, trust, offset, spacing = (np.empty(count) for _ in range(4))

    def work(part: slice) -> None:
        x, facing = vertices[part], directions[part]
        index = nearest(patches.tree, x, min(NEIGHBOURS, len(patches.points)), 1)[1]
        first = pull(patches, x, facing, index)
        trust[part], front[part], offset[part] = first.trust, first.front, first.height
        spacing[part] = patches.spacing[index[:, 0]]
        y = x + first.step
        for _ in range(STEPS - 1):
            y = y + pull(patches, y, facing, index).step
        step[part] = first.trust[:, None] * (y - x)
        outward[part] = first.outward

    in_parts(work, count, threads)
    return Aim(step, outward, front, trust, offset, spacing)


def _gain(aim: Aim, deviation: float) -> float:
    """Share of the way to the data that noise leaves worth going: 1 − s²/D².

    D is the distance between the field's surface and the local fit, s the standard error of that
    fit, both by medians. If the two err independently this combination has the least error.
    """
    own = (aim.front > 0.9) & (aim.trust > 0.9)
    if not own.any():
        return 1.0
    distance = 1.48 * float(np.median(np.abs(aim.offset[own])))
    return float(np.clip(1 - (deviation / max(distance, 1e-300)) ** 2, 0, 1))


def _shared(aim: Aim, vertices: Array, gain: float, threads: int) -> Array:
    """Steps of which the data have only a share: a shell's second wall follows its first."""
    step = gain * aim.step
    back, own = np.flatnonzero(aim.back), np.flatnonzero(aim.front > 0.9)
    if len(back) and len(own):
        partner = own[nearest(cKDTree(vertices[own]), vertices[back], 1, threads)[1][:, 0]]
        # The first wall stays short of the data by this much; the second keeps its distance.
        outward = unit_normals(aim.outward[back])
        short = (1 - gain) * np.einsum("vi,vi->v", aim.step[partner], outward)
        step[back] = aim.step[back] - short[:, None] * outward
    return step


def _normals(aim: Aim, share: Array, directions: Array) -> Array:
    """(v, 3) the data's normals where vertices reached the data and those are of one mind, ∇θ
    elsewhere: at rims, in gaps, where vertices stayed back."""
    weight = share * aim.trust
    agreed = np.linalg.norm(aim.outward, axis=1)
    return unit_normals(
        weight[:, None] * aim.outward + (1 - weight * np.minimum(agreed, 1))[:, None] * directions
    )


def _thickness(vertices: Array, faces: Indices, front: Array) -> tuple[float, float] | None:
    """Median and least distance from the second wall of shells to the first."""
    back = np.flatnonzero(front < 0.1)
    own = faces[(front[faces] > 0.9).all(1)]
    if not len(back) or not len(own):
        return None
    picked = vertices[back[:: max(1, len(back) // PROBES)]]
    square, _, _ = igl.point_mesh_squared_distance(picked, vertices, np.ascontiguousarray(own))
    distance = np.sqrt(np.maximum(square, 0))
    return float(np.median(distance)), float(distance.min())
