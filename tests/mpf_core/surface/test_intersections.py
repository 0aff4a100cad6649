"""Triangles through triangles, against every pair tested by hand and by libigl."""

from __future__ import annotations

import igl
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from mpf_core.field.pointwise import uncompiled
from mpf_core.surface.intersections import Boxes, self_intersections
from mpf_core.surface.mesh import Mesh
from tests.mpf_core.quality.meshes import box, grid_sheet, icosphere, joined, moved


def test_clean_surfaces_have_none() -> None:
    shift = np.array([4.5e5, 5.4e6, 300.0])
    for mesh in (icosphere(3), box(), grid_sheet(20), moved(icosphere(3), 3.0, shift)):
        assert len(self_intersections(mesh)) == 0


def test_two_spheres_as_every_pair_says() -> None:
    both = joined(icosphere(2), moved(icosphere(2), 1.0, np.array([0.7, 0.31, 0.13])))
    half = len(both.faces) // 2
    corners = both.vertices[both.faces]
    expected = {
        (i, j)
        for i in range(half)
        for j in range(half, 2 * half)
        if igl.tri_tri_intersection_test_3d(
            *[np.ascontiguousarray(p[None]) for p in (*corners[i], *corners[j])]
        )[0]
    }
    assert {(int(i), int(j)) for i, j in self_intersections(both)} == expected


def test_triangles_with_a_common_vertex() -> None:
    vertices = np.array([[0.0, 0, 0], [2, -1, 0], [2, 1, 0], [1, 0, -1], [1, 0, 1], [1, 3, 1]])
    through = Mesh(vertices, np.array([[0, 1, 2], [3, 4, 0]]))
    beside = Mesh(vertices, np.array([[0, 1, 2], [0, 4, 5]]))
    assert self_intersections(through).tolist() == [[0, 1]]
    assert len(self_intersections(beside)) == 0


def test_touching_and_coplanar_triangles_do_not_count() -> None:
    flat = joined(grid_sheet(3), moved(grid_sheet(3), 1.0, np.array([0.5, 0.5, 0])))
    assert len(self_intersections(flat)) == 0
    standing = np.array([[0.0, 0, 0], [1, 0, 0], [0, 0, 1]])
    touching = joined(grid_sheet(2), Mesh(standing, np.array([[0, 1, 2]])))
    assert len(self_intersections(touching)) == 0


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 120), st.booleans())
def test_compiled_or_not_the_same_pairs(seed: int, count: int, on_a_lattice: bool) -> None:
    """On a lattice many corners lie exactly on other triangles' planes and edges."""
    rng = np.random.default_rng(seed)
    vertices = rng.random((max(count // 2, 9), 3))
    if on_a_lattice:
        vertices = np.round(3 * vertices)
    soup = Mesh(vertices, rng.integers(0, len(vertices), (count, 3)))
    found = self_intersections(soup)
    with uncompiled():
        assert np.array_equal(found, self_intersections(soup))


def test_as_many_pairs_as_there_are() -> None:
    """More than a part of the walk has room for at first."""
    rng = np.random.default_rng(0)
    needles = Mesh(rng.normal(size=(1200, 3)), np.arange(1200).reshape(-1, 3))
    found = self_intersections(needles)
    assert len(found) > 4 * len(needles.faces)
    with uncompiled():
        assert np.array_equal(found, self_intersections(needles))


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 150))
def test_no_pair_of_boxes_is_missed(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    corners = rng.random((count, 1, 3)) + rng.random((count, 3, 3)) * rng.choice([0.05, 0.5])
    low, high = corners.min(axis=1), corners.max(axis=1)
    meet = ((low[:, None] <= high) & (low <= high[:, None])).all(axis=2)
    expected = {(i, j) for i, j in np.argwhere(meet).tolist() if i < j}
    boxes = Boxes.of(corners)
    batches = [pairs for part in boxes.parts() for pairs in boxes.meeting(part)]
    found = [tuple(pair) for pairs in batches for pair in pairs.tolist()]
    assert sorted(found) == sorted(expected)
