"""From the zero level in the normalised frame to a mesh in the input's: floaters off, normals and
colours on."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mpf_core.cloud.neighbors import distance_within, nearest
from mpf_core.cloud.normalize import Similarity
from mpf_core.surface.cut import pieces
from mpf_core.surface.isosurface import Isosurface
from mpf_core.surface.mesh import Mesh
from mpf_core.surface.normals import unit_normals

FLOATER_SPACINGS = 2.0  # a component that comes no nearer to any sample is not of the cloud
COLOR_NEIGHBOURS = 3

Array = NDArray[np.float64]
Gradient = Callable[[Array], NDArray[np.float32]]


def without_floaters(
    surface: Isosurface, samples: cKDTree, spacing: float, *, least: int = 0
) -> tuple[Array, NDArray[np.int64], int]:
    """Vertices and faces without components that the samples do not speak for.

    Those go that are farther than two spacings from every sample, and those that fewer than
    `least` samples are nearest to. Returns also how many were removed. If all are far, all are
    kept: the caller sees the distances.
    """
    faces = surface.faces
    count, piece = pieces(faces, len(surface.vertices))
    distance = distance_within(samples, surface.vertices, FLOATER_SPACINGS * spacing)
    near = np.zeros(count, dtype=bool)
    near[piece[np.isfinite(distance)]] = True
    if not near.any():
        return surface.vertices, faces, 0
    if near.sum() > 1 and least > 0:
        _, closest = cKDTree(surface.vertices).query(samples.data, workers=-1)
        support = np.bincount(piece[closest], minlength=count)
        near &= support >= min(least, support[near].max())
    if near.all():
        return surface.vertices, faces, 0
    keep = near[piece]
    index = np.cumsum(keep) - 1
    return surface.vertices[keep], index[faces[keep[faces[:, 0]]]], int((~near).sum())


def finish(
    vertices: Array,
    faces: NDArray[np.int64],
    gradient: Gradient,
    similarity: Similarity,
    colors: tuple[cKDTree, NDArray[np.uint8]] | None,
) -> Mesh:
    """The mesh in the input's frame, with ∇θ as vertex normals and the samples' colours."""
    normals = unit_normals(gradient(vertices).astype(np.float64))
    return Mesh(
        vertices=similarity.to_input(vertices),
        faces=faces,
        normals=normals,
        colors=None if colors is None else blended(vertices, *colors),
    )


def blended(vertices: Array, samples: cKDTree, colors: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """(v, 3) colours at `vertices`, those of the nearest `samples` weighted by inverse distance."""
    distance, index = nearest(samples, vertices, COLOR_NEIGHBOURS)
    weight = 1 / np.maximum(distance, 1e-9)
    weight /= weight.sum(1, keepdims=True)
    mixed = np.einsum("vk,vkc->vc", weight, colors[index].astype(np.float64))
    whole: NDArray[np.uint8] = np.rint(mixed).astype(np.uint8)
    return whole
