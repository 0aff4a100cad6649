"""Consistent orientation of PCA normals: pieces that grow together by the evidence between them.

Two neighbours agree if one's normal, mirrored in the plane half way between them, looks the way of
the other's (König & Gumhold 2009): across the edge of two faces too, where the normals themselves
are perpendicular and tell nothing. A spanning tree of such links (Hoppe et al. 1992) turns all that
hangs on a single wrong one; here every piece joins the one to which the sum of its links, for or
against, is largest, all pieces at once as in Borůvka's trees, until none is left to join.

Enclosed space tells which side is outward; where nothing is enclosed each connected piece keeps one
consistent, arbitrary side.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph

from mpf_core.cloud.neighbors import Neighborhoods
from mpf_core.fit.freespace import INSIDE, FreeSpace

# Evidence is told in links that one sample has to another; between two that have each other it is
# up to 2.
HINT = 0.4  # that the normal of a thin wall leaves it
SWEEPS = 10  # over what is left against its links
LEAST = 1e-6  # that a link gives, so that no neighbour stays apart
NOTHING = 1e-9  # what is left by rounding where for and against are the same

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


def outward_seeds(neighbours: Neighborhoods, space: FreeSpace) -> Array:
    """(n,) evidence that the PCA normal is outward, negative that it is inward, 0 where there is
    none.

    Enclosed space has up to three votes. The normal of a sample on a thin wall leaves the
    wall, unless enclosed space lies there: then the wall is a crack between two bodies. That is a
    hint: in a sheet's tight folds it is so on alternate sides.
    """
    votes, outward = np.zeros(len(neighbours.points)), np.zeros(len(neighbours.points))
    for steps in (1.5, 2.5, 4.0):
        for side in (1.0, -1.0):
            probe = neighbours.points + side * steps * space.voxel * neighbours.normals
            inside = space.label_at(probe) == INSIDE
            votes -= side * inside
            outward += inside if side > 0 else 0.0
    return np.where(neighbours.layered, np.where(outward > 1, -HINT, HINT), votes)


def orient(neighbours: Neighborhoods, seeds: Array) -> Array:
    """(n, 3) normals with signs that agree, by the evidence of `seeds` (n,) outward; a piece that
    has none keeps the sign of its first sample."""
    return neighbours.normals * agreed_signs(_evidence(neighbours, seeds))[:, None]


def agreed_signs(evidence: sparse.csr_array) -> Array:
    """(n,) signs ±1 with which symmetric evidence (n + 1, n + 1) holds as far as it can; the last
    is the root, whose sign is +1, and a piece not joined to it keeps that of its first."""
    n, links = evidence.shape[0] - 1, evidence
    sign, piece = np.ones(n + 1), np.arange(n + 1)
    while evidence.nnz:
        flip, joined = _joined(evidence)
        members = sparse.csr_array((flip, (np.arange(len(flip)), joined)))
        evidence = _without_own((members.T @ evidence @ members).tocsr())
        sign *= flip[piece]
        piece = joined[piece]
    sign = _settled(links, sign)
    _, first = np.unique(piece, return_index=True)
    known = sign[first]
    known[piece[n]] = sign[n]  # what hangs on a seed has the seed's
    agreed: Array = (sign * known[piece])[:n]
    return agreed


def _settled(evidence: sparse.csr_array, sign: Array) -> Array:
    """`sign` (k,) with those turned over, one by one, whose own links are against them on the
    whole: what joined first did so by a single link. The root, which is the last, stays."""
    for _ in range(SWEEPS):
        against = -sign * (evidence @ sign)
        worst = _largest_of_rows(evidence, against[evidence.indices])  # beside each
        turned = (against > 0) & (against > worst)
        turned[-1] = False
        if not turned.any():
            break
        sign = np.where(turned, -sign, sign)
    return sign


def _largest_of_rows(evidence: sparse.csr_array, values: Array) -> Array:
    """(k,) the largest of the `values` that the entries of each row have, −∞ where it has none."""
    some = np.flatnonzero(np.diff(evidence.indptr))
    largest = np.full(evidence.shape[0], -np.inf)
    largest[some] = np.maximum.reduceat(values, evidence.indptr[some])
    return largest


def _evidence(neighbours: Neighborhoods, seeds: Array) -> sparse.csr_array:
    """(n + 1, n + 1) symmetric: for each pair of linked samples how surely their normals have the
    same side, negative if opposite ones; the last row is of the seeds.

    Sure are links within a common tangent plane.
    """
    n, points = len(neighbours.points), neighbours.points
    tail = np.repeat(np.arange(n), neighbours.links.shape[1])
    head = neighbours.links.ravel().astype(np.int64)
    agreement = _agreement(neighbours, tail, head)
    step = points[head] - points[tail]
    climb = np.abs(np.einsum("ni,ni->n", step, neighbours.normals[tail]))
    climb /= np.linalg.norm(step, axis=1) + 1e-12
    sure = np.maximum(np.abs(agreement) - 0.5 * climb, 0.0) ** 2 + LEAST
    seeded = np.flatnonzero(seeds)
    rows = np.concatenate([tail, np.full(len(seeded), n)])
    columns = np.concatenate([head, seeded])
    values = np.concatenate([np.where(agreement < 0, -sure, sure), seeds[seeded]])
    one_way = sparse.coo_array((values, (rows, columns)), shape=(n + 1, n + 1)).tocsr()
    return _without_own((one_way + one_way.T).tocsr())


def _without_own(evidence: sparse.csr_array) -> sparse.csr_array:
    """Without what pieces say of themselves, and where for and against are the same."""
    evidence.setdiag(0.0)
    evidence.data[np.abs(evidence.data) < NOTHING] = 0.0
    evidence.eliminate_zeros()
    return evidence


def _joined(evidence: sparse.csr_array) -> tuple[Array, Indices]:
    """Each piece with that for which its evidence is strongest: (k,) −1 where it has to turn over
    for that, and (k,) numbers of the larger pieces."""
    k = evidence.shape[0]
    strength, row = np.abs(evidence.data), np.repeat(np.arange(k), np.diff(evidence.indptr))
    at = np.flatnonzero(strength == _largest_of_rows(evidence, strength)[row])
    some, first = np.unique(row[at], return_index=True)  # of equals the first
    other = evidence.indices[at[first]].astype(np.int64)
    chosen = sparse.coo_array((np.ones(len(some)), (some, other)), shape=(k, k)).tocsr()
    count_of, joined = csgraph.connected_components(chosen, directed=False)
    # All trees hang under a virtual root by their first piece.
    first = np.unique(joined, return_index=True)[1]
    rows = np.concatenate([some, np.full(count_of, k)])
    columns = np.concatenate([other, first])
    forest = sparse.coo_array((np.ones(len(rows)), (rows, columns)), shape=(k + 1, k + 1))
    _, above = csgraph.breadth_first_order(forest.tocsr(), k, directed=False)
    parent = above.astype(np.int64)
    parent[k] = k
    sign = np.ones(k + 1)
    under = np.flatnonzero(parent[:k] < k)
    sign[under] = np.where(np.asarray(evidence[under, parent[under]]).ravel() < 0, -1.0, 1.0)
    return _product_to_root(sign, parent)[:k], joined.astype(np.int64)


def _agreement(neighbours: Neighborhoods, tail: Indices, head: Indices) -> Array:
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
