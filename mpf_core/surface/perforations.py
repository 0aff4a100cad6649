"""Pinholes through thin walls, closed where the samples show an unbroken sheet.

Between two samples the two walls of a thin shell may meet and leave a tunnel from one side to the
other, as wide as the samples are apart: nothing in the data asks for it. A tunnel shows by its
saddles, and the triangles in a ball about them make a ring with two boundary loops, one in each
wall; they give way to two caps. Where the samples end, leave out a hole, or bend sharply, nothing
is touched.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from mpf_core.cloud.angles import widest_gap
from mpf_core.cloud.neighbors import OPEN_ANGLE, nearest, principal_axes
from mpf_core.heeding import heed
from mpf_core.surface.cut import boundary_loops, pieces, used
from mpf_core.surface.mesh import Mesh
from mpf_core.surface.normals import corner_angles

# What makes a tunnel's saddles: radians that the angles at a vertex exceed 2π by (4π in all), and
# spacings between them. Narrow tunnels first, which wide groups would take together.
PASSES = ((0.3, 0.25), (0.3, 0.5), (0.15, 0.75), (0.15, 1.5))
AROUND = 16  # samples that tell the sheet
FLAT = 0.45  # their spread across it over that along it, above which it is no sheet
MARGINS = (0.15, 0.3, 0.5, 0.75, 1.0)  # spacings past its saddles within which a tunnel ends
WIDEST = 3.0  # spacings from its middle: caps over wider ones, which are flat, leave the sheet
# Largest distance to the nearest sample over that to the last of AROUND: where samples leave out
# more, as random ones hardly do once in ten thousand, the hole is the object's.
LEFT_OUT = 0.6
# Places in one pass, of some milliseconds each. A surface with more is no sheet with pinholes but
# the noise of a fit that has hardly begun, or has failed; one took over 20 minutes.
MOST = 5000

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]


def without_perforations(
    vertices: Array, faces: Indices, samples: cKDTree, spacing: float
) -> tuple[Array, Indices, int]:
    """The closed mesh with its pinholes capped, and how many places that were; normalised units.

    `samples` has the cloud's, `spacing` apart.
    """
    closed, angles = 0, _angles(vertices, faces)
    for excess, together in PASSES:
        heed()
        saddles = vertices[angles > 2 * np.pi + excess]
        tunnels = _tunnels(saddles, samples, together * spacing)
        if len(tunnels) > MOST:
            continue
        vertices, faces, count = _capped(vertices, faces, tunnels, spacing)
        if count:
            closed, angles = closed + count, _angles(vertices, faces)
    return vertices, faces, closed


def _capped(
    vertices: Array, faces: Indices, tunnels: list[tuple[Array, float]], spacing: float
) -> tuple[Array, Indices, int]:
    """The mesh with those of the tunnels capped that prove to be some, and how many did."""
    if not tunnels:
        return vertices, faces, 0
    tree, touching = cKDTree(vertices), _touching(faces, len(vertices))
    removed, caps = np.zeros(len(faces), dtype=bool), []
    middles: list[Array] = []
    for middle, radius in tunnels:
        heed()
        ring = None
        for margin in MARGINS:
            reach = radius + margin * spacing
            if reach > WIDEST * spacing:
                break
            within = np.asarray(tree.query_ball_point(middle, reach))
            wider = _ring(faces, touching, within)
            # Past the first that works, so that the caps lie in the walls, not in the tunnel.
            ring, settled = wider or ring, ring is not None
            if settled:
                break
        if ring is None or removed[ring[0]].any():
            continue
        removed[ring[0]] = True
        for loop in ring[1]:
            hub = np.full(len(loop), len(vertices) + len(middles))
            middles.append(vertices[loop].mean(0))
            caps.append(np.stack([loop, np.roll(loop, -1), hub], axis=1))
    if not caps:
        return vertices, faces, 0
    vertices = np.concatenate([vertices, np.stack(middles)])
    kept = np.concatenate([faces[~removed], *caps])
    vertices, faces, _ = used(vertices, kept, np.arange(len(vertices)))
    return vertices, faces, len(caps) // 2


def _tunnels(saddles: Array, samples: cKDTree, together: float) -> list[tuple[Array, float]]:
    """Middles (3,) and radii of groups of saddles (n, 3) on sheets which the samples show whole."""
    if not len(saddles):
        return []
    pairs = cKDTree(saddles).query_pairs(together, output_type="ndarray")
    graph = sparse.coo_array((np.ones(len(pairs)), pairs.T), shape=(len(saddles),) * 2)
    count, group = connected_components(graph, directed=False)
    size = np.bincount(group)
    middle = np.stack([np.bincount(group, saddles[:, i]) / size for i in range(3)], axis=1)
    radius = np.zeros(count)
    np.maximum.at(radius, group, np.linalg.norm(saddles - middle[group], axis=1))
    whole = _is_sheet(middle, samples)
    return [(middle[k], float(radius[k])) for k in np.flatnonzero(whole)]


def _angles(vertices: Array, faces: Indices) -> Array:
    """(v,) the sum of the angles at each vertex; more than 2π at saddles."""
    angles = corner_angles(Mesh(vertices, faces))
    return np.asarray(np.bincount(faces.ravel(), angles.ravel(), len(vertices)), np.float64)


def _is_sheet(points: Array, samples: cKDTree) -> Mask:
    """(n,) whether the samples around points (n, 3) are one sheet that goes on on all sides."""
    distance, index = nearest(samples, points, min(AROUND, samples.n))
    patch = np.asarray(samples.data)[index]
    values, axes = principal_axes(patch, distance)
    flat = np.sqrt(np.maximum(values[:, 0], 0)) < FLAT * np.sqrt(np.maximum(values[:, 1], 1e-300))
    offset = patch - points[:, None]
    first, second = ((offset @ axes[:, :, k][..., None])[..., 0] for k in (2, 1))
    _, gap = widest_gap(np.arctan2(second, first))
    near = distance[:, 0] < LEFT_OUT * distance[:, -1]
    return np.asarray(flat & near & (gap < OPEN_ANGLE))


def _touching(faces: Indices, vertices: int) -> sparse.csr_array:
    """Which faces touch each vertex."""
    corners = faces.ravel()
    owners = np.repeat(np.arange(len(faces)), 3)
    return sparse.csr_array(
        (np.ones(len(corners), dtype=np.int8), (corners, owners)), shape=(vertices, len(faces))
    )


def _ring(
    faces: Indices, touching: sparse.csr_array, within: Indices
) -> tuple[Indices, list[Indices]] | None:
    """The triangles whose corners are all `within`, and their two boundary loops, as caps run round
    them, if they make a ring: connected, no loop touching itself or the other, Euler characteristic
    0, or less for many tunnels."""
    # Each triangle is there once for every corner within.
    near = np.sort(_rows(touching, within))
    inside = near[2:][near[2:] == near[:-2]].astype(np.int64)
    if not len(inside):
        return None
    corners = faces[inside]
    names, local = np.unique(corners, return_inverse=True)
    local = local.reshape(-1, 3)
    start, stop = local.ravel(), np.roll(local, -1, axis=1).ravel()
    size = len(names)
    single = start[~np.isin(start * size + stop, stop * size + start)]
    # Most are no ring, and what is cheap to ask tells so.
    if not len(single) or size - (len(start) + len(single)) // 2 + len(local) > 0:
        return None
    if np.bincount(single).max() > 1 or pieces(local, size)[0] != 1:
        return None
    # What runs round a hole of the ring is the ring's own turned about.
    loops = [loop[::-1] for loop in boundary_loops(corners)]
    return (inside, loops) if len(loops) == 2 else None


def _rows(matrix: sparse.csr_array, rows: Indices) -> Indices:
    """The columns of all entries in `rows`."""
    begin, end = matrix.indptr[rows], matrix.indptr[rows + 1]
    count = end - begin
    before = np.cumsum(count) - count
    return np.asarray(matrix.indices[np.repeat(begin - before, count) + np.arange(count.sum())])
