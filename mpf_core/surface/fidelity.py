"""The last step: vertices of the extracted mesh move onto the locally fitted data.

Solids move along the normal onto the surface through the samples; of the shell around an open
sheet, the wall that passes through the samples moves onto them and the other to a thin, even
distance behind. Triangles stay as they are, so nothing loses its manifoldness; where a triangle
would fold over or cross another, its vertices stay back. Noise limits the step: what the samples'
scatter cannot tell from the field's own surface is left to the field.
"""

from __future__ import annotations

from dataclasses import dataclass

import igl
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mpf_core.cloud.neighbors import nearest
from mpf_core.fit.initialize import Initialization
from mpf_core.fit.orientation import outward_seeds
from mpf_core.surface.mesh import Mesh
from mpf_core.surface.normals import unit_normals, vertex_normals
from mpf_core.surface.planes import NEIGHBOURS, Planes, in_parts, planes_of, pull
from mpf_core.surface.takeback import Crossings, Motion, allowed_share

STEPS = 3  # moves onto the surface; the second is already a tenth of the first
FARTHEST = 1.0  # local spacings that a vertex moves at most
LEAST_GAIN = 0.1  # of the step's length justified by the data, below which it is not taken
BEHIND = 3.0  # shell half thicknesses within which a wall behind has samples of its own
PROBES = 20_000  # vertices at which the thickness is measured

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


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


def follow_data(
    vertices: Array,
    faces: Indices,
    directions: Array,
    start: Initialization,
    *,
    thickness: float,
    crossings: Crossings,
    threads: int = -1,
) -> Moved:
    """Move `vertices` (v, 3) with unit outward `directions` (v, 3) onto the data of `start`.

    `thickness` is that of shells around sheets; `crossings` finds pairs of faces that cross.
    """
    cloud = start.local.neighbours
    planes = planes_of(cloud, start.normals, _of_sheets(start), thickness, threads)
    aim = _aim(planes, vertices, directions, threads)
    gain = _gain(aim, planes)
    step = _shared(aim, vertices, gain, threads) if gain < 1 else aim.step
    length = np.linalg.norm(step, axis=1)
    step *= np.minimum(1.0, FARTHEST * aim.spacing / np.maximum(length, 1e-300))[:, None]
    if gain < LEAST_GAIN and not aim.back.any():
        step[:] = 0.0
    motion = Motion(vertices, faces, step, aim.outward)
    share = allowed_share(motion, crossings) if step.any() else np.zeros(len(vertices))
    moved = motion.at(share).vertices
    length = np.linalg.norm(moved - vertices, axis=1)
    applied = bool(length.any())
    return Moved(
        vertices=moved,
        normals=vertex_normals(Mesh(moved, faces)) if applied else directions,
        applied=applied,
        gain=gain,
        bandwidth=planes.bandwidth * cloud.median_spacing,
        deviation=planes.deviation,
        mean=float(length.mean()),
        largest=float(length.max()),
        taken_back=int((share < 1)[faces].any(1).sum()),
        thickness=_thickness(moved, faces, aim.front),
    )


def _of_sheets(start: Initialization) -> NDArray[np.bool_]:
    """(n,) whether a sample has nothing behind it: no enclosed space, no samples facing away."""
    cloud, normals = start.local.neighbours, start.normals
    enclosing = outward_seeds(cloud, start.space) != 0
    distance, index = nearest(cloud.tree, cloud.points, NEIGHBOURS)
    offset = cloud.points[index] - cloud.points[:, None]
    depth = -np.einsum("nki,ni->nk", offset, normals)
    away = np.einsum("nki,ni->nk", normals[index], normals) < -0.5
    reach = np.minimum(distance, 2 * cloud.spacing[:, None])
    behind = away & (depth > 0) & (depth < BEHIND * start.shell + 0.5 * reach)
    solid = (enclosing | behind.any(1)).astype(np.float64)
    # One sample's finding is not to be trusted against its neighbours'.
    return np.asarray(solid[index].mean(1) < 0.5)


@dataclass(frozen=True)
class _Aim:
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


def _aim(planes: Planes, vertices: Array, directions: Array, threads: int) -> _Aim:
    count = len(vertices)
    step, outward = np.empty((count, 3)), np.empty((count, 3))
    front, trust, offset, spacing = (np.empty(count) for _ in range(4))

    def work(part: slice) -> None:
        x, facing = vertices[part], directions[part]
        index = nearest(planes.tree, x, min(NEIGHBOURS, len(planes.points)), 1)[1]
        first = pull(planes, x, facing, index)
        trust[part], front[part], offset[part] = first.trust, first.front, first.offset
        spacing[part] = planes.spacing[index[:, 0]]
        y = x + first.step
        for _ in range(STEPS - 1):
            y = y + pull(planes, y, facing, index).step
        step[part] = first.trust[:, None] * (y - x)
        outward[part] = unit_normals(first.outward)

    in_parts(work, count, threads)
    return _Aim(step, outward, front, trust, offset, spacing)


def _gain(aim: _Aim, planes: Planes) -> float:
    """Share of the way to the data that noise leaves worth going: 1 − s²/D².

    D² is the mean square distance between the field's surface and the local fit, s the standard
    error of that fit. If the two err independently this is the combination with the least error.
    """
    own = (aim.front > 0.9) & (aim.trust > 0.9)
    if not own.any():
        return 1.0
    error = np.abs(aim.offset[own])
    usual = np.minimum(error, 4 * np.median(error))
    return float(np.clip(1 - planes.deviation**2 / max(float((usual**2).mean()), 1e-300), 0, 1))


def _shared(aim: _Aim, vertices: Array, gain: float, threads: int) -> Array:
    """Steps of which the data have only a share: a shell's second wall follows its first."""
    step = gain * aim.step
    back, own = np.flatnonzero(aim.back), np.flatnonzero(aim.front > 0.9)
    if len(back) and len(own):
        partner = own[nearest(cKDTree(vertices[own]), vertices[back], 1, threads)[1][:, 0]]
        # The first wall stays short of the data by this much; the second keeps its distance.
        short = (1 - gain) * np.einsum("vi,vi->v", aim.step[partner], aim.outward[back])
        step[back] = aim.step[back] - short[:, None] * aim.outward[back]
    return step


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
