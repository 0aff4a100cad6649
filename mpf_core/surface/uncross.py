"""Walls that decimation led through one another, parted again.

Large triangles are chords of the walls that they stand for. Where those bend, a chord leaves its
wall by more than a thin shell is thick, and meets the other one. So each triangle of a crossing
pair moves until it is on its own wall where the two meet: the walls do not cross, and with their
distance there the triangles have it. Only vertices move, by about as much as decimation was off.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mpf_core.cloud.neighbors import nearest
from mpf_core.surface.intersections import self_intersections
from mpf_core.surface.mesh import Mesh
from mpf_core.surface.normals import face_crosses, face_normals

SEARCHED, MOST_ROUNDS = 600_000, 30  # faces in all rounds together (20 µs each), and rounds
PATIENCE = 5  # rounds without fewer crossings: the fine walls cross there themselves
MOST_FACES = 150_000  # looked at: the report counts no more, either
NEIGHBOURS = 24  # fine triangles of which the nearest that faces the same way is of the same wall
FACING = 0.5  # cosine above which it does
HALVINGS = 3  # of steps that would turn a triangle over, before they are not taken

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


def uncrossed(coarse: Mesh, fine: Mesh) -> Array:
    """Vertices (v, 3) of `coarse`, a decimation of `fine`, moved until no two triangles cross.

    Where that does not end, as where `fine` crosses itself, the vertices with the fewest pairs are
    returned; no triangle turns over.
    """
    if len(coarse.faces) > MOST_FACES:
        return coarse.vertices
    mesh, best = coarse, coarse.vertices
    fewest, since = np.inf, 0
    walls: _Walls | None = None
    for _ in range(min(MOST_ROUNDS, 1 + SEARCHED // max(len(coarse.faces), 1))):
        pairs = self_intersections(mesh)
        since += 1
        if len(pairs) < fewest:
            fewest, since, best = len(pairs), 0, mesh.vertices
        if fewest == 0 or since == PATIENCE:
            break
        walls = walls or _Walls(fine)
        step = _without_turns(coarse, mesh.vertices, _steps(mesh, pairs, walls))
        mesh = Mesh(mesh.vertices + step, coarse.faces)
    return best


class _Walls:
    """The fine triangles, to be asked where the wall near a point is."""

    def __init__(self, fine: Mesh):
        self.normals = face_normals(fine)
        self.middles = fine.vertices[fine.faces].mean(1)
        self.tree = cKDTree(self.middles)

    def way(self, x: Array, normal: Array) -> Array:
        """(n, 3) from points x to the wall that faces as `normal` (n, 3); 0 where there is none."""
        near = nearest(self.tree, x, min(NEIGHBOURS, len(self.middles)))[1]
        facing = np.einsum("nki,ni->nk", self.normals[near], normal) > FACING
        own = near[np.arange(len(x)), facing.argmax(1)]
        height = np.einsum("ni,ni->n", self.middles[own] - x, self.normals[own])
        way: Array = (height * facing.any(1))[:, None] * self.normals[own]
        return way


def _steps(mesh: Mesh, pairs: Indices, walls: _Walls) -> Array:
    """(v, 3) the mean over the crossing triangles at each vertex of their way to their walls."""
    x, found = _meeting_points(mesh.vertices[mesh.faces], pairs)
    faces, x = pairs[found].ravel(), np.repeat(x[found], 2, axis=0)
    way = walls.way(x, face_normals(mesh)[faces])
    count = np.bincount(mesh.faces[faces].ravel(), minlength=len(mesh.vertices))
    total = np.zeros_like(mesh.vertices)
    np.add.at(total, mesh.faces[faces], way[:, None])
    step: Array = total / np.maximum(count, 1)[:, None]
    return step


def _meeting_points(corners: Array, pairs: Indices) -> tuple[Array, NDArray[np.bool_]]:
    """(k, 3) the middle of where edges of one triangle of a pair cut the other, and whether they
    do."""
    total, count = np.zeros((len(pairs), 3)), np.zeros(len(pairs))
    for one, other in (pairs.T, pairs.T[::-1]):
        triangle = corners[other]
        sides = np.roll(triangle, -1, axis=1) - triangle
        normal = np.cross(sides[:, 0], sides[:, 1])
        heights = np.einsum("kci,ki->kc", corners[one] - triangle[:, :1], normal)
        for k in range(3):
            low, high = heights[:, k], heights[:, (k + 1) % 3]
            through = low * high < 0
            share = low / np.where(through, low - high, 1)
            start, stop = corners[one, k], corners[one, (k + 1) % 3]
            x = start + share[:, None] * (stop - start)
            turns = np.einsum("kci,ki->kc", np.cross(sides, x[:, None] - triangle), normal)
            through &= (turns > 0).all(1)
            total[through] += x[through]
            count += through
    return total / np.maximum(count, 1)[:, None], count > 0


def _without_turns(coarse: Mesh, vertices: Array, step: Array) -> Array:
    """`step` (v, 3) from `vertices`, shortened where it would turn a triangle of `coarse` over."""
    before = face_crosses(coarse)
    share = np.ones(len(vertices))
    halvings = 0
    while True:
        after = face_crosses(Mesh(vertices + share[:, None] * step, coarse.faces))
        turned = np.unique(coarse.faces[np.einsum("fi,fi->f", before, after) <= 0])
        if not share[turned].any():
            break  # none, or none that this step turns
        # What stays may turn a neighbour that was sound while both moved: looked at again.
        share[turned] *= 0.5 if halvings < HALVINGS else 0.0
        halvings += 1
    shortened: Array = share[:, None] * step
    return shortened
