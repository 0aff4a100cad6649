"""Consistent orientation of PCA normals: a spanning tree over tangent planes (Hoppe et al. 1992).

Two neighbours agree if one's normal, mirrored in the plane half way between them, looks the way of
the other's (König & Gumhold 2009): across the edge of two faces too, where the normals themselves
are perpendicular and tell nothing.

Enclosed space seeds the tree with outward signs; where nothing is enclosed each connected piece
keeps one consistent, arbitrary side.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph

from mpf_core.cloud.neighbors import Neighborhoods
from mpf_core.fit.freespace import INSIDE, FreeSpace

Array = NDArray[np.float64]


def outward_seeds(neighbours: Neighborhoods, space: FreeSpace) -> Array:
    """(n,) positive where the PCA normal leaves enclosed space, negative where it enters, or 0.

    The normal of a sample on a thin wall leaves the wall, unless enclosed space lies there: then
    the wall is a crack between two bodies.
    """
    votes, outward = np.zeros(len(neighbours.points)), np.zeros(len(neighbours.points))
    for steps in (1.5, 2.5, 4.0):
        for side in (1.0, -1.0):
            probe = neighbours.points + side * steps * space.voxel * neighbours.normals
            inside = space.label_at(probe) == INSIDE
            votes -= side * inside
            outward += inside if side > 0 else 0.0
    return np.where(neighbours.layered, np.where(outward > 1, -1.0, 1.0), votes)


def orient(neighbours: Neighborhoods, seeds: Array) -> Array:
    """(n, 3) normals with signs that agree along a minimum spanning tree from the seeds."""
    n, normals = len(neighbours.points), neighbours.normals
    tree = _spanning_tree(neighbours, seeds)
    # Pieces without a seed hang under the virtual root n by their first sample, sign kept.
    _, piece = csgraph.connected_components(tree, directed=False)
    first = np.unique(piece, return_index=True)[1]
    first = first[(first < n) & (piece[first] != piece[n])]
    ones = np.ones(len(first))
    roots = sparse.coo_array((ones, (np.full(len(first), n), first)), shape=tree.shape).tocsr()
    _, parent = csgraph.breadth_first_order(tree + roots, n, directed=False)
    child = np.arange(n)
    above = parent[:n]
    hung = above == n
    agree = _agreement(neighbours, child, np.where(hung, 0, above))
    seed_sign = np.where(seeds < 0, -1.0, 1.0)
    sign = np.append(np.where(hung, seed_sign, np.where(agree < 0, -1.0, 1.0)), 1.0)
    parent[n] = n
    return normals * _product_to_root(sign, parent)[:n, None]


def _spanning_tree(neighbours: Neighborhoods, seeds: Array) -> sparse.csr_array:
    """Minimum spanning tree; edges are cheap between samples that share a tangent plane."""
    n, normals, points = len(neighbours.points), neighbours.normals, neighbours.points
    tail = np.repeat(np.arange(n), neighbours.links.shape[1])
    head = neighbours.links.ravel().astype(np.int64)
    step = points[head] - points[tail]
    bend = 1 - np.abs(_agreement(neighbours, tail, head))
    climb = np.abs(np.einsum("ni,ni->n", step, normals[tail]))
    cost = 1e-3 + bend + 0.5 * climb / (np.linalg.norm(step, axis=1) + 1e-12)
    seeded = np.flatnonzero(seeds)
    rows = np.concatenate([tail, np.full(len(seeded), n)])
    columns = np.concatenate([head, seeded])
    costs = np.concatenate([cost, np.full(len(seeded), 1e-6)])
    graph = sparse.coo_array((costs, (rows, columns)), shape=(n + 1, n + 1)).tocsr()
    # coo → csr adds duplicates up; the graph has none, since a link is listed once per tail.
    tree = csgraph.minimum_spanning_tree(graph.maximum(graph.T))
    return sparse.csr_array(tree + tree.T)


def _agreement(
    neighbours: Neighborhoods, tail: NDArray[np.int64], head: NDArray[np.int64]
) -> Array:
    """(m,) cosine between the normals of samples `tail` (m,) and the mirrored ones of `head`."""
    step = neighbours.points[head] - neighbours.points[tail]
    step /= np.linalg.norm(step, axis=1, keepdims=True) + 1e-300
    one, other = neighbours.normals[tail], neighbours.normals[head]
    across = np.einsum("ni,ni->n", one, step) * np.einsum("ni,ni->n", other, step)
    return np.asarray(np.einsum("ni,ni->n", one, other) - 2 * across)


def _product_to_root(sign: Array, parent: NDArray[np.integer]) -> Array:
    """Product of signs along the path to the root, by pointer doubling: log₂(depth) rounds.

    The root is its own parent and has sign 1.
    """
    product, above = sign.copy(), parent.astype(np.int64)
    while not np.array_equal(above, above[above]):
        product *= product[above]
        above = above[above]
    return product * product[above]
