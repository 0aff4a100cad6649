"""Closed, oriented surfaces for every pattern of signs."""

from __future__ import annotations

from collections import Counter
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mpf_core.surface import cubes
from mpf_core.surface.isosurface import Grid, Isosurface, extract
from mpf_core.surface.lattice import SPAN

FAR_TREE = cKDTree(np.zeros((1, 3)))


def surface_of(signs: NDArray[np.bool_]) -> Isosurface:
    """The surface around the True vertices of a small grid, padded with positive ones."""
    shape = np.full(3, SPAN)  # of the grid that holds them and positive vertices all around
    padded = np.ones(shape + 1, dtype=np.float32)
    padded[tuple(slice(2, 2 + n) for n in signs.shape)][signs] = -1
    grid = Grid(np.zeros(3), 1.0, shape, levels=0)

    def evaluate(x: NDArray[np.float64]) -> NDArray[np.float32]:
        """Linear along the grid's edges."""
        low = np.clip(np.floor(x).astype(int), 0, shape - 1)
        share, value = x - low, np.zeros(len(x))
        for corner in product((0, 1), repeat=3):
            weight = np.prod(np.where(corner, share, 1 - share), axis=1)
            value += weight * padded[tuple((low + corner).T)]
        return value.astype(np.float32)

    return extract(evaluate, grid, FAR_TREE, reach=0.0)


def directed_edges(faces: NDArray[np.int64]) -> Counter[tuple[int, int]]:
    return Counter((int(f[i]), int(f[(i + 1) % 3])) for f in faces for i in range(3))


def volume(surface: Isosurface) -> float:
    a, b, c = (surface.vertices[surface.faces[:, k]] for k in range(3))
    return float(np.einsum("fi,fi->f", a, np.cross(b, c)).sum() / 6)


def assert_closed_and_oriented(surface: Isosurface) -> None:
    edges = directed_edges(surface.faces)
    assert all(count == edges[b, a] == 1 for (a, b), count in edges.items())
    assert volume(surface) > 0


@pytest.mark.parametrize("start", range(0, 256, 64))
def test_every_pattern_gives_a_closed_surface_turned_outwards(start: int) -> None:
    for pattern in range(max(start, 1), start + 64):
        signs = np.array([bool(pattern >> c & 1) for c in range(8)]).reshape(2, 2, 2).T
        assert_closed_and_oriented(surface_of(signs))


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.1, 0.3, 0.5, 0.7, 0.9]))
def test_every_grid_of_signs_gives_a_closed_manifold(seed: int, filled: float) -> None:
    """Every edge belongs to two triangles that pass it in opposite directions."""
    rng = np.random.default_rng(seed)
    signs = rng.uniform(size=(4, 5, 3)) < filled
    signs[1, 1, 1] = True
    assert_closed_and_oriented(surface_of(signs))


def test_the_table_uses_exactly_the_cut_edges() -> None:
    counts, edges = cubes.table()
    assert counts.shape == (256,)
    for pattern in range(256):
        negative = [bool(pattern >> c & 1) for c in range(8)]
        cut = {n for n, (a, b) in enumerate(cubes.EDGES) if negative[a] != negative[b]}
        used = edges[pattern, : counts[pattern]]
        assert set(used.ravel().tolist()) == cut
        assert (edges[pattern, counts[pattern] :] == -1).all()
    assert counts[0] == counts[255] == 0
    assert {int(counts[1 << c]) for c in range(8)} == {1}


def test_triangles_face_the_positive_side() -> None:
    counts, edges = cubes.table()
    middle = (cubes.CORNERS[cubes.EDGE_LOWER] + cubes.CORNERS[cubes.EDGE_UPPER]) / 2
    for corner in range(8):
        assert counts[1 << corner] == 1
        a, b, c = middle[edges[1 << corner, 0]]
        away = (a + b + c) / 3 - cubes.CORNERS[corner]
        assert np.cross(b - a, c - a) @ away > 0


def test_patterns_read_signs_and_zero_counts_as_outside() -> None:
    values = np.array([[-1, 1, 1, 1, 1, 1, 1, -1], [0] * 8], dtype=np.float32)
    assert cubes.patterns(values).tolist() == [0b10000001, 0]
