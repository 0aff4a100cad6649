"""How far each vertex may go before a triangle folds over, collapses or crosses another.

Faces on their data and along the wall that those describe seldom meet, since walls keep their
distance: the others and what is near them is looked at first, the whole mesh once those are sound.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial import cKDTree

from mpf_core.cloud.neighbors import distance_within
from mpf_core.surface.intersections import self_intersections
from mpf_core.surface.mesh import Mesh
from mpf_core.surface.normals import face_crosses, unit_normals

FLAT = 1e-4  # of a face's area: what is left less has collapsed
ALIGNED = 0.5  # cosine to the data's normal above which a face lies along its wall
REACH = 4.0  # median radii of a face within which others are looked at
SWEEPS = 12  # searches of the whole mesh; most are sound after four, the rest needs six or seven
LEAST = 1e-2  # share of a step below which none is taken
GIVEN_UP = 8  # rounds in which vertices around what is still spoilt go nowhere, twice as far each
ROUNDS = 14  # in which steps are shortened in the places found by one
FIRST = 1 / 32  # of a step that is taken off first
YIELDING = 0.5  # share of its step down to which a second wall alone makes way for a first
MOST_FACES = 700_000  # looked at as a whole: one fit's mesh; some 3 µs and 1 kB each

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True)
class Motion:
    """vertices, step: (v, 3); faces: (f, 3); outward: (v, 3) the data's normals; settled: (v,)
    whether the whole step leads onto the data; second: (v,) whether it is of a shell's second wall,
    which may lie farther behind than it was to."""

    vertices: Array
    faces: Indices
    step: Array
    outward: Array
    settled: NDArray[np.bool_]
    second: NDArray[np.bool_]

    def at(self, share: Array) -> Mesh:
        """The mesh when each vertex takes its `share` (v,) of the step."""
        return Mesh(self.vertices + share[:, None] * self.step, self.faces)

    def moving(self, share: Array, faces: Indices) -> NDArray[np.bool_]:
        """(f,) whether a corner of each of `faces` (f, 3) goes anywhere with its `share` (v,)."""
        return np.asarray(((share > 0) & self.step.any(1))[faces].any(1))


def allowed_share(motion: Motion) -> Array:
    """(v,) share in [0, 1] of its step that each vertex may take; all zero if none is safe."""
    share = np.ones(len(motion.vertices))
    ring = neighbours_of(motion.faces, len(share))
    near = _suspects(motion, share)
    for _ in range(SWEEPS):
        near, bad = _spoilt_anywhere(motion, share, near)
        if not len(bad):
            return share
        before = share.copy()
        for _ in range(ROUNDS):
            reached = _beside(motion.faces[bad], ring)
            share[reached] = shortened(share[reached])
            # No jump between who goes and who stays: that would fold the faces between.
            share[reached] = np.minimum(share, ring @ share)[reached]
            # Only what has changed since can have become worse.
            changed = near[reached[motion.faces[near]].any(1)]
            bad = _spoilt(motion, share, around(motion.at(share), changed, near))
            if not len(bad):
                break
        else:
            share[_beside(motion.faces[reached[motion.faces].any(1)], ring)] = 0.0
        # The rest was found sound where it is; what moved back may have met others.
        moved = np.flatnonzero((share != before)[motion.faces].any(1))
        near = around(motion.at(share), moved)
    return _given_up(motion, share, near)


def shortened(share: Array) -> Array:
    """(n,) the next smaller share of a step: twice as much is taken off, then half of the rest; 0
    where that is next to nothing."""
    kept = np.where(share > 0.5, 1 - np.maximum(2 * (1 - share), FIRST), 0.5 * share)
    return np.where(kept < LEAST, 0.0, kept)


def _given_up(motion: Motion, share: Array, near: Indices) -> Array:
    """`share` with nothing around what is still spoilt, and from there rising with the distance;
    all zero if that leaves something spoilt.

    Distances are measured through space, so that the two walls of a shell stop at the same place:
    along the surface, one would go on past where the other stays.
    """
    marks, radius, most = np.empty((0, 3)), np.empty(0), share
    for _ in range(GIVEN_UP):
        near, bad = _spoilt_anywhere(motion, share, near)
        if not len(bad):
            return share
        corners = np.unique(motion.faces[bad])
        longest = np.linalg.norm(motion.step[corners], axis=1).max()
        found = motion.vertices[corners]
        least = max(_reach(Mesh(motion.vertices, motion.faces), near), float(longest))
        radius = np.concatenate([radius, _wider(marks, radius, found, least)])
        marks = np.concatenate([marks, found])
        before, share = share, most * _ramp(marks, radius, motion.vertices)
        changed = np.flatnonzero((share != before)[motion.faces].any(1))
        near = around(motion.at(share), changed)
    return share * (len(_spoilt_anywhere(motion, share, near)[1]) == 0)


def _wider(marks: Array, radius: Array, found: Array, least: float) -> Array:
    """(k,) radius for each of `found` (k, 3): twice that of the mark (m, 3) about which it lies."""
    wide = np.full(len(found), least)
    for size, distance in _from_marks(marks, radius, found):
        wide = np.where(np.isfinite(distance), np.maximum(wide, 2 * size), wide)
    return wide


def _ramp(marks: Array, radius: Array, x: Array) -> Array:
    """(n,) at x (n, 3): 0 within the radius of a mark, 1 from twice that on."""
    share = np.ones(len(x))
    for size, distance in _from_marks(marks, radius, x):
        share = np.minimum(share, np.clip(distance / size - 1, 0, 1))
    return share


def _from_marks(marks: Array, radius: Array, x: Array) -> Iterator[tuple[float, Array]]:
    """Each radius with (n,) the distance from x to the nearest of its marks, infinite from twice
    that on."""
    for size in np.unique(radius):
        yield size, distance_within(cKDTree(marks[radius == size]), x, 2 * size, 1)


def _beside(faces: Indices, ring: sparse.csr_array) -> NDArray[np.bool_]:
    """(v,) the corners of `faces` and their neighbours."""
    marked = np.zeros(ring.shape[0])
    marked[faces] = 1.0
    return np.asarray(ring @ marked > 0)


def _suspects(motion: Motion, share: Array) -> Indices:
    """Faces that are not on the data or turned from their normal, and those near them."""
    mesh = motion.at(share)
    after, before = face_crosses(mesh), face_crosses(motion.at(0 * share))
    along = unit_normals(motion.outward[mesh.faces].sum(1))
    area = np.linalg.norm(after, axis=1)
    risky = np.einsum("fi,fi->f", after, along) < ALIGNED * area
    risky |= np.einsum("fi,fi->f", after, before) <= 0
    risky |= area < FLAT * np.linalg.norm(before, axis=1)
    risky |= ~(motion.settled & (share == 1))[mesh.faces].all(1)
    risky &= motion.moving(share, mesh.faces)
    return around(mesh, np.flatnonzero(risky))


def around(mesh: Mesh, risky: Indices, among: Indices | None = None) -> Indices:
    """Those of the faces `among`, of all if not given, that are `risky` or near such a one."""
    if not len(risky):
        return risky
    among = np.arange(len(mesh.faces)) if among is None else among
    tree = cKDTree(mesh.vertices[mesh.faces[risky]].mean(1))
    middle = mesh.vertices[mesh.faces[among]].mean(1)
    return among[np.isfinite(distance_within(tree, middle, _reach(mesh, among), 1))]


def _reach(mesh: Mesh, among: Indices) -> float:
    """How far from one of the faces `among` others are looked at."""
    corners = mesh.vertices[mesh.faces[among]]
    return REACH * float(np.median(np.linalg.norm(corners[:, 0] - corners.mean(1), axis=1)))


def _spoilt_anywhere(motion: Motion, share: Array, near: Indices) -> tuple[Indices, Indices]:
    """Faces to look at further and those spoilt: of the faces `near`, and of all if none is."""
    bad = _spoilt(motion, share, near)
    if len(bad) or len(motion.faces) > MOST_FACES:
        return near, bad
    bad = _spoilt(motion, share, np.arange(len(motion.faces)))
    return around(motion.at(share), bad), bad


def _spoilt(motion: Motion, share: Array, near: Indices) -> Indices:
    """Those of the faces `near` that the step folded over, flattened or led through another."""
    if not len(near):
        return near
    faces = motion.faces[near]
    mesh = Mesh(motion.at(share).vertices, faces)
    after, before = face_crosses(mesh), face_crosses(Mesh(motion.vertices, faces))
    moved = motion.moving(share, faces)
    folded = np.asarray(np.einsum("fi,fi->f", after, before) <= 0)
    folded |= np.linalg.norm(after, axis=1) < FLAT * np.linalg.norm(before, axis=1)
    pairs = self_intersections(mesh)
    # A crossing of faces that have not moved was there before.
    new = pairs[moved[pairs].any(1)]
    crossing = _to_shorten(motion, share, faces, new)
    spoilt: Indices = np.unique(np.concatenate([np.flatnonzero(folded & moved), crossing]))
    return near[spoilt]


def _to_shorten(motion: Motion, share: Array, faces: Indices, pairs: Indices) -> Indices:
    """Faces of the crossing `pairs` (k, 2) that must go less far: of a first and a second wall, the
    second alone for as long as it can, so that the first stays on the data."""
    second = np.asarray(motion.second[faces].all(1))
    yielding = np.asarray(second & (share[faces] > YIELDING).any(1))
    first, other = pairs[:, 0], pairs[:, 1]
    held = np.stack([~second[first] & yielding[other], ~second[other] & yielding[first]], axis=1)
    return np.asarray(pairs[~held])


def neighbours_of(faces: Indices, count: int) -> sparse.csr_array:
    """(v, v) matrix that takes the mean over a vertex and those that share a face with it."""
    tail, head = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    own = np.arange(count)
    rows, columns = np.concatenate([tail, head, own]), np.concatenate([head, tail, own])
    graph = sparse.csr_array((np.ones(len(rows)), (rows, columns)), shape=(count, count))
    return sparse.csr_array(graph.multiply(1 / graph.sum(1)[:, None]))
