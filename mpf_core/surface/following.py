"""Moving vertices towards their aim: as far as noise and triangles allow, in two rounds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import igl
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mpf_core.cloud.neighbors import nearest
from mpf_core.heeding import Late
from mpf_core.surface.aim import Aim
from mpf_core.surface.normals import unit_normals
from mpf_core.surface.takeback import Motion, allowed_share

ROUNDS = 2  # a third gains a third to a tenth of what the second does
# Local spacings, or thicknesses of the field's shell, that a vertex moves in a round at most.
FARTHEST = 1.0
SETTLED = 0.99  # trust from which a vertex is taken to reach the data
LEAST_GAIN = 0.1  # of the step's length justified by the data, below which it is not taken
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
