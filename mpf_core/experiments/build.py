"""Pieces that test shapes are made of: grids, surfaces of revolution, tubes, cells, leaves.

A shape *is* its triangles: where it is curved it is a fine polyhedron, and samples and distances
refer to that polyhedron exactly.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mpf_core.quality.meshio import welded
from mpf_core.surface.mesh import Mesh

Floats = NDArray[np.float64]


def tidy(vertices: Floats, faces: NDArray[np.int64]) -> Mesh:
    """Equal positions joined, triangles that lose a corner by it dropped."""
    mesh = welded(Mesh(np.asarray(vertices, np.float64), np.asarray(faces, np.int64)))
    a, b, c = mesh.faces.T
    return Mesh(mesh.vertices, mesh.faces[(a != b) & (b != c) & (c != a)])


def grid(points: Floats, *, around: bool = False, twist: bool = False) -> Mesh:
    """Two triangles per cell of points (m, n, 3); `around` joins the last row to the first.

    `twist` joins it the other way round, as a Möbius strip is joined.
    """
    m, n, _ = points.shape
    index = np.arange(m * n).reshape(m, n)
    if around or twist:
        index = np.concatenate([index, index[:1, ::-1] if twist else index[:1]])
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    halves = [np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))]
    return tidy(points.reshape(-1, 3), np.concatenate(halves))


def patch(corner: ArrayLike, u: ArrayLike, v: ArrayLike) -> Mesh:
    """A flat parallelogram from `corner` along `u` and `v`."""
    start, along, across = (np.asarray(x, np.float64) for x in (corner, u, v))
    return grid(np.array([[start, start + across], [start + along, start + along + across]]))


def lathe(profile: ArrayLike, sections: int = 192) -> Mesh:
    """The surface of revolution about z of a polyline of (radius, z).

    Outward when the polyline runs upwards on the outside; a closed polyline makes a solid ring.
    """
    radius, height = np.asarray(profile, np.float64).T
    angle = np.linspace(0, 2 * np.pi, sections, endpoint=False)[:, None]
    flat = np.broadcast_to(height, (sections, len(height)))
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), flat], axis=2)
    return grid(points, around=True)


def curve(points: ArrayLike, count: int) -> Floats:
    """(count, d) points on the cubic spline through `points`, natural at its ends."""
    from scipy.interpolate import CubicSpline

    knots = np.asarray(points, np.float64)
    steps = np.linalg.norm(np.diff(knots, axis=0), axis=1)
    at = np.concatenate([[0], np.cumsum(steps)])
    spline = CubicSpline(at, knots, bc_type="natural")
    return np.asarray(spline(np.linspace(0, at[-1], count)))


def tube(path: Floats, radius: ArrayLike, sections: int = 14) -> Mesh:
    """A tube about `path` (k, 3) of radius (k,) or one number, closed at its far end only."""
    radii = np.broadcast_to(np.asarray(radius, np.float64), len(path))
    tangent = np.gradient(path, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    side = np.cross(tangent[0], np.eye(3)[np.argmin(np.abs(tangent[0]))])
    angle = np.linspace(0, 2 * np.pi, sections, endpoint=False)[:, None]
    rings = []
    for point, along, r in zip(path, tangent, radii, strict=True):
        # The side is carried along the path without turning about it.
        side = side - (side @ along) * along
        side /= np.linalg.norm(side)
        rings.append(point + r * (np.cos(angle) * side + np.sin(angle) * np.cross(along, side)))
    rings.append(np.broadcast_to(path[-1], (sections, 3)))
    return grid(np.stack(rings, axis=1), around=True)


def cells(edges: Sequence[ArrayLike], filled: NDArray[np.bool_]) -> Mesh:
    """The boundary of a union of boxes: `filled` (nx, ny, nz) between `edges` along each axis."""
    x, y, z = (np.asarray(e, np.float64) for e in edges)
    corners = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1)
    strides = np.array([len(y) * len(z), len(z), 1])
    padded = np.pad(filled, 1)
    quads = []
    for axis in range(3):
        across, up = (axis + 1) % 3, (axis + 2) % 3
        change = np.diff(padded.astype(np.int8), axis=axis)
        for sign in (-1, 1):
            place = np.argwhere(change == sign) - 1
            place[:, axis] += 1
            start = place @ strides
            loop = [0, strides[across], strides[across] + strides[up], strides[up]]
            quad = start[:, None] + np.array(loop if sign < 0 else loop[::-1])
            quads.append(quad)
    quad = np.concatenate(quads)
    faces = np.concatenate([quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]])
    return tidy(corners.reshape(-1, 3)[np.unique(faces)], np.searchsorted(np.unique(faces), faces))


def box(low: ArrayLike, high: ArrayLike) -> Mesh:
    """An axis-aligned solid box."""
    edges = np.stack([np.asarray(low, np.float64), np.asarray(high, np.float64)], axis=1)
    return cells(list(edges), np.ones((1, 1, 1), bool))


def boxes(*spans: Sequence[Sequence[float]]) -> Mesh:
    """The union of axis-aligned boxes, each ((x0, x1), (y0, y1), (z0, z1))."""
    array = np.asarray(spans, np.float64)
    edges = [np.unique(array[:, axis]) for axis in range(3)]
    middles = [(e[:-1] + e[1:]) / 2 for e in edges]
    filled = np.zeros([len(m) for m in middles], bool)
    for span in array:
        within = [(m > lo) & (m < hi) for m, (lo, hi) in zip(middles, span, strict=True)]
        filled |= within[0][:, None, None] & within[1][:, None] & within[2]
    return cells(edges, filled)


def blade(
    length: float, width: float, *, bend: float = 0.3, fold: float = 0.2, tip: float = 0.75
) -> Mesh:
    """A leaf from the origin along +x, its face up: pointed, folded at the midrib, bending down.

    bend, fold: as shares of the length and of the half-width; tip < 1 moves the widest part back.
    """
    u = np.linspace(0, 1, 61)[:, None]
    v = np.linspace(-1, 1, 25)
    half = 0.5 * width * np.sin(np.pi * u**tip).clip(0) ** 0.85 + 0.0 * v
    half[[0, -1]] = 0.0
    drop = bend * length * u**2
    x = length * (u - 0.35 * bend * u**3) + 0.0 * v
    return grid(np.stack([x, half * v, fold * half * np.abs(v) ** 1.5 - drop], axis=2))


def placed(
    mesh: Mesh, at: ArrayLike, *, turn: float = 0.0, rise: float = 0.0, roll: float = 0.0
) -> Mesh:
    """`mesh` rolled about x, raised from x towards z, turned about z (degrees), moved to `at`."""
    rotation = _turned(2, turn) @ _turned(1, -rise) @ _turned(0, roll)
    return Mesh(mesh.vertices @ rotation.T + np.asarray(at), mesh.faces, None, mesh.colors)


def _turned(axis: int, degrees: float) -> Floats:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    rotation = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    rotation[[i, i, j, j], [i, j, i, j]] = c, -s, s, c
    return rotation


def painted(mesh: Mesh, color: Sequence[int]) -> Mesh:
    """`mesh` in one RGB colour."""
    colors = np.tile(np.array(color, np.uint8), (len(mesh.vertices), 1))
    return Mesh(mesh.vertices, mesh.faces, None, colors)


def joined(*meshes: Mesh) -> Mesh:
    """All triangles in one mesh; vertices are not welded across the pieces."""
    offsets = np.cumsum([0, *(len(m.vertices) for m in meshes[:-1])])
    colors = None
    if any(m.colors is not None for m in meshes):
        grey = [painted(m, (170, 170, 170)) if m.colors is None else m for m in meshes]
        colors = np.concatenate([m.colors for m in grey if m.colors is not None])
    return Mesh(
        np.concatenate([m.vertices for m in meshes]),
        np.concatenate([m.faces + k for m, k in zip(meshes, offsets, strict=True)]),
        None,
        colors,
    )


def normalised(mesh: Mesh) -> Mesh:
    """`mesh` with its box centred and the longest side 2."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    vertices = (mesh.vertices - (low + high) / 2) * (2 / (high - low).max())
    return Mesh(vertices, mesh.faces, None, mesh.colors)
