"""One layer of triangles for open surfaces, taken from the closed shell that MPF wraps them in.

Of the shell's two walls the one whose outward side agrees with the oriented normals of the samples
lies on the data; it is kept as far as the data reach. Where the mesh encloses a solid there is no
second wall and nothing is dropped. All lengths are normalised.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from mpf_core.cloud.neighbors import Neighborhoods, nearest
from mpf_core.cloud.normalize import Similarity
from mpf_core.errors import NoSurface
from mpf_core.fit.initialize import Initialization
from mpf_core.surface import cut
from mpf_core.surface.mesh import Mesh
from mpf_core.surface.normals import face_areas, vertex_normals
from mpf_core.surface.quadric import height_of_data
from mpf_core.surface.rim import Rim
from mpf_core.surface.simplify import neighbour_mean

FRONT = 0.35  # cosine above which one is on the first: what is steeper would fold up on the data
BACK = -0.3  # cosine to the samples' normals below which a vertex is on the second wall
SMALLEST_PATCH = 50  # samples; fewer are no sheet on a solid, and no solid on a sheet
SMALLEST_PIECE = 16  # samples that a piece must be the nearest to: those of one plane fit
SMOOTHING = 8  # rounds: three cells, less than the shell's rim is wide
EDGE = 0.3  # spacings by which a surface ends beyond the mean of its rim samples
PINHOLE = 3.0  # spacings across; a wider hole in the layer is left open
EVENING = 15  # rounds of averaging, over less than a spacing
TRUST = 0.25  # spacings by which quadric and local fit may differ; beyond, samples are too few
SEAM = 4  # samples along which normals turn over; fewer are an accident of the estimate

Array = NDArray[np.float64]
Faces = NDArray[np.int64]
Flags = NDArray[np.bool_]


@dataclass(frozen=True)
class SingleLayer:
    """The layer, and how much of it was double before.

    vertices: (v, 3), faces: (f, 3) int64, normalised
    double_share: share of the layer's area that had a second wall behind it
    thickness: median distance between the two walls, or None
    solids: closed pieces kept whole; pinholes: holes closed in the layer
    orientable: False where the normals of the samples cannot agree (a Möbius strip): the layer is
        then parted along a line
    """

    vertices: Array
    faces: Faces
    double_share: float
    thickness: float | None
    solids: int
    pinholes: int
    orientable: bool

    def as_dict(self, similarity: Similarity) -> dict[str, Any]:
        """What the report tells, lengths in the input's units."""
        thin = self.thickness
        return {
            "share_of_area": round(self.double_share, 4),
            "median_thickness": None if thin is None else similarity.length_to_input(thin),
            "closed_solids": self.solids,
            "pinholes_closed": self.pinholes,
            "orientable": self.orientable,
        }


def single_layer(vertices: Array, faces: Faces, start: Initialization) -> SingleLayer:
    """The one layer on the data of a closed mesh (v, 3), (f, 3) that wraps the samples.

    `start` gives the samples, their oriented normals and the local fit. Raises NoSurface when
    nothing is left.
    """
    cloud, threads = start.local.neighbours, start.local.threads
    near = start.local.at(vertices)
    outward = vertex_normals(Mesh(vertices, faces))
    front = cut.smoothed(faces, (outward * near.normal).sum(1), SMOOTHING)
    distance, index = nearest(cloud.tree, vertices, 4, threads)
    back = front < BACK
    turned = _turned(cloud, start.normals)
    solid_samples = start.bounds.solid > 0.5
    doubled = _doubled_samples(cloud, np.unique(index[back, 0]), turned, solid_samples)
    if not doubled.any():
        return SingleLayer(vertices, faces, 0.0, None, _closed(faces, vertices), 0, True)
    weight = 1 / (distance + 0.1 * near.spacing[:, None])
    sheet = (weight * np.where(doubled, 1.0, -1.0)[index]).sum(1) / weight.sum(1)
    sheet = cut.smoothed(faces, sheet, SMOOTHING)
    rim = Rim.of(cloud)
    over = cut.smoothed(faces, EDGE - rim.beyond(vertices, threads), SMOOTHING)
    walls = face_areas(Mesh(vertices, faces))
    back &= sheet > 0
    behind = walls[back[faces].all(1)].sum()

    layer = _supported(
        *cut.clip(vertices, faces, np.minimum(front, np.minimum(sheet, over)))[:2], cloud
    )
    layer, pinholes = _without_pinholes(*layer, cloud)
    layer = _onto_data(*layer, start)
    solid = _supported(*cut.clip(vertices, faces, -sheet)[:2], cloud)
    solid = _shut(*solid, cloud)
    joined, triangles = _joined(solid, layer)
    if len(triangles) == 0:
        raise NoSurface("no part of the surface lies on the data", advice="Fit for longer.")
    area = face_areas(Mesh(joined, triangles)).sum()
    return SingleLayer(
        vertices=joined,
        faces=triangles,
        double_share=float(min(behind / area, 1.0)),
        thickness=_between(near.signed, (front > FRONT) & (sheet > 0), back),
        solids=_closed(solid[1], solid[0]),
        pinholes=pinholes,
        orientable=int((turned & doubled & ~_grown(cloud, ~doubled, 3)).sum()) < SEAM,
    )


def _between(height: Array, first: Flags, second: Flags) -> float | None:
    """Median distance of the second wall from the first, whichever of them is on the data."""
    if not (first.any() and second.any()):
        return None
    return float(abs(np.median(height[first]) - np.median(height[second])))


def _turned(cloud: Neighborhoods, normals: Array) -> Flags:
    """(n,) samples with a neighbour on the same layer whose oriented normal is opposite."""
    step = cloud.points[cloud.links] - cloud.points[:, None]
    height = np.abs(np.einsum("nki,ni->nk", step, normals))
    beside = height < 0.3 * np.linalg.norm(step, axis=2)
    against = np.einsum("nki,ni->nk", normals[cloud.links], normals) < -0.7
    return np.asarray((beside & against).any(1))


def _grown(cloud: Neighborhoods, member: Flags, rings: int) -> Flags:
    """`member` and its neighbours, `rings` times over."""
    for _ in range(rings):
        member = member | member[cloud.links].any(1)
    return member


def _doubled_samples(
    cloud: Neighborhoods, seen: NDArray[np.int64], turned: Flags, solid: Flags
) -> Flags:
    """(n,) whether a second wall lies behind each sample, in patches that deserve the name.

    Never of a sample that bounds a `solid`: beside the foot of a sheet its normal is nobody's.

    `seen` are the samples that vertices of second walls are nearest to. Where normals turn over
    within a sheet the walls change places, and neither can be told from the other.
    """
    doubled = np.zeros(len(cloud.points), dtype=bool)
    doubled[seen] = True
    doubled |= _grown(cloud, turned, 2) & _grown(cloud, doubled, 3)
    for _ in range(3):
        doubled = doubled[cloud.links].mean(1) > 0.5
    doubled &= ~solid
    for kind in (True, False):
        doubled ^= _small_patches(cloud, doubled == kind)
    return doubled


def _small_patches(cloud: Neighborhoods, member: Flags) -> Flags:
    """Which of the samples `member` form patches of few samples."""
    n, k = cloud.links.shape
    tail, head = np.repeat(np.arange(n), k), cloud.links.ravel()
    both = member[tail] & member[head]
    ones = np.ones(int(both.sum()))
    graph = sparse.coo_array((ones, (tail[both], head[both])), shape=(n, n))
    _, patch = connected_components(graph, directed=False)
    return member & (np.bincount(patch)[patch] < SMALLEST_PATCH)


def _supported(vertices: Array, faces: Faces, cloud: Neighborhoods) -> tuple[Array, Faces]:
    """Without pieces that few samples are near to."""
    if len(faces) == 0:
        return vertices, faces
    count, piece = cut.pieces(faces, len(vertices))
    _, index = nearest(cloud.tree, vertices, 1)
    pairs = np.unique(np.stack([piece.astype(np.int64), index[:, 0]], 1), axis=0)
    kept = np.bincount(pairs[:, 0], minlength=count) >= SMALLEST_PIECE
    return cut.used(vertices, faces[kept[piece[faces[:, 0]]]], np.arange(len(vertices)))[:2]


def _without_pinholes(
    vertices: Array, faces: Faces, cloud: Neighborhoods
) -> tuple[tuple[Array, Faces], int]:
    """The layer with its small holes closed; the outermost curve of each piece stays."""
    loops = cut.boundary_loops(faces)
    _, piece = cut.pieces(faces, len(vertices))
    owner = np.array([piece[loop[0]] for loop in loops], dtype=np.int64)
    across = np.array([np.linalg.norm(np.ptp(vertices[loop], axis=0)) for loop in loops])
    holes = []
    for number, loop in enumerate(loops):
        outermost = across[number] >= across[owner == owner[number]].max()
        if not outermost and across[number] < PINHOLE * cloud.median_spacing:
            holes.append(loop)
    return cut.filled(vertices, faces, holes), len(holes)


def _shut(vertices: Array, faces: Faces, cloud: Neighborhoods) -> tuple[Array, Faces]:
    """A solid closed along the slits where sheets were cut off; wide openings stay."""
    slits = []
    for loop in cut.boundary_loops(faces):
        ring = vertices[loop]
        length = np.linalg.norm(ring - np.roll(ring, -1, axis=0), axis=1).sum()
        area = face_areas(Mesh(vertices, cut.filling(vertices, loop))).sum()
        if area < length * cloud.median_spacing:
            slits.append(loop)
    return cut.filled(vertices, faces, slits)


def _onto_data(vertices: Array, faces: Faces, start: Initialization) -> tuple[Array, Faces]:
    """Vertices moved onto the samples' surface, and spread evenly over it.

    First along the local fit, which is robust, then along a quadric, which is exact. Evening out
    takes the jags off the boundary as well; it leads off the surface by little, and back again.
    """
    if len(faces) == 0:
        return vertices, faces
    mean = neighbour_mean(faces, len(vertices))
    moved = vertices
    for rounds in (0, EVENING):
        for _ in range(rounds):
            moved = (moved + mean @ moved) / 2
        for fine in (False, True):
            near = start.local.at(moved)
            step = -near.signed
            if fine:
                exact = height_of_data(
                    start.local.neighbours, moved, near.normal, start.normals, start.local.threads
                )
                step = np.where(np.abs(exact - step) < TRUST * near.spacing, exact, step)
            moved = moved + np.clip(step, -near.spacing, near.spacing)[:, None] * near.normal
    return moved, faces


def _joined(first: tuple[Array, Faces], second: tuple[Array, Faces]) -> tuple[Array, Faces]:
    return (
        np.concatenate([first[0], second[0]]),
        np.concatenate([first[1], second[1] + len(first[0])]),
    )


def _closed(faces: Faces, vertices: Array) -> int:
    """Pieces without a boundary."""
    if len(faces) == 0:
        return 0
    count, piece = cut.pieces(faces, len(vertices))
    loops = cut.boundary_loops(faces)
    return count - len({int(piece[loop[0]]) for loop in loops})
