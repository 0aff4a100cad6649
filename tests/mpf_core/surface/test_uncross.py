"""Decimation leads thin walls through one another; they are parted again."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import Delaunay

from mpf_core.cloud.normalize import Similarity
from mpf_core.experiments.shapes import shape
from mpf_core.field import MetricPhaseField
from mpf_core.field.fitted import FittedField
from mpf_core.field.footprint import Footprint
from mpf_core.options import SurfaceOptions
from mpf_core.quality.topology import topology
from mpf_core.surface.edit import edited
from mpf_core.surface.intersections import self_intersections
from mpf_core.surface.mesh import Mesh
from mpf_core.surface.normals import face_crosses, vertex_normals
from mpf_core.surface.simplify import decimated, deviation
from mpf_core.surface.uncross import _without_turns, uncrossed

THIN = 0.0012  # 0.03 of the spacing of some three thousand samples, 0.06 of ten thousand


@cache
def shell(name: str) -> Mesh:
    """The closed shell around a sheet of `shapes`, its walls THIN apart."""
    sheet = shape(name)
    count, half = len(sheet.vertices), THIN / 2 * vertex_normals(sheet)
    tail, head = sheet.faces.ravel(), np.roll(sheet.faces, -1, axis=1).ravel()
    edges = set(zip(tail.tolist(), head.tolist(), strict=True))
    a, b = np.array([edge for edge in sorted(edges) if edge[::-1] not in edges]).T
    rim = [np.stack([b, a, a + count], axis=1), np.stack([b, a + count, b + count], axis=1)]
    faces = np.concatenate([sheet.faces, sheet.faces[:, ::-1] + count, *rim])
    return Mesh(np.concatenate([sheet.vertices + half, sheet.vertices - half]), faces)


@pytest.mark.parametrize(("name", "target"), [("leaf", 1000), ("saddle", 2000), ("dress", 8000)])
def test_walls_that_decimation_crossed_are_parted(name: str, target: int) -> None:
    fine = shell(name)
    assert len(self_intersections(fine)) == 0
    coarse = Mesh(*decimated(fine.vertices, fine.faces, target))
    assert len(self_intersections(coarse)) > 0
    parted = Mesh(uncrossed(coarse, fine), coarse.faces)
    assert len(self_intersections(parted)) == 0
    before, after = topology(coarse), topology(parted)
    assert after.watertight
    assert replace(after, slivers=before.slivers) == before
    turned = np.einsum("fi,fi->f", face_crosses(parted), face_crosses(coarse)) <= 0
    assert not turned.any()
    off, moved = (
        deviation((fine.vertices, fine.faces), (m.vertices, m.faces)) for m in (coarse, parted)
    )
    assert moved.largest < 2 * off.largest


def test_what_does_not_cross_stays_as_it_is() -> None:
    fine = shell("leaf")
    coarse = Mesh(*decimated(fine.vertices, fine.faces, 4000))
    assert uncrossed(coarse, fine) is coarse.vertices


def test_a_surface_that_crosses_itself_gets_no_worse() -> None:
    leaf = shell("leaf")
    twice = Mesh(
        np.concatenate([leaf.vertices, leaf.vertices + np.array([0.1, 0.02, 0.01])]),
        np.concatenate([leaf.faces, leaf.faces + len(leaf.vertices)]),
    )
    coarse = Mesh(*decimated(twice.vertices, twice.faces, 4000))
    moved = Mesh(uncrossed(coarse, twice), coarse.faces)
    assert 0 < len(self_intersections(moved)) <= len(self_intersections(coarse))
    turned = np.einsum("fi,fi->f", face_crosses(moved), face_crosses(coarse)) <= 0
    assert not turned.any()


def test_the_walls_of_what_is_asked_for_do_not_cross() -> None:
    """The way of a user who asks for `max_faces`, in metres far from the origin."""
    similarity = Similarity(np.array([448_262.125, 5_411_932.5, 312.0]), 20.0)
    fine = shell("leaf")
    mesh = Mesh(similarity.to_input(fine.vertices), fine.faces)
    samples = fine.vertices[::10]
    footprint = Footprint.of(samples, spacing=0.02, reach=0.02, thickness=THIN)
    fitted = FittedField(MetricPhaseField(width=8), similarity, np.ones((2, 3)), footprint)
    final = edited(mesh, SurfaceOptions(max_faces=1000), fitted)
    assert len(final.mesh.faces) <= 1024
    assert len(self_intersections(final.mesh)) == 0
    told = final.edits["decimation"]["largest_distance"]
    far = deviation((mesh.vertices, mesh.faces), (final.mesh.vertices, final.mesh.faces))
    assert told == pytest.approx(far.largest, rel=1e-3)


@given(st.integers(0, 10_000), st.floats(0.01, 1.0))
def test_no_step_turns_a_triangle_over(seed: int, size: float) -> None:
    rng = np.random.default_rng(seed)
    flat = rng.uniform(size=(40, 2))
    vertices = np.concatenate([flat, np.zeros((40, 1))], axis=1)
    mesh = Mesh(vertices, Delaunay(flat).simplices.astype(np.int64))
    step = size * rng.normal(size=(40, 3))
    moved = Mesh(vertices + _without_turns(mesh, vertices, step), mesh.faces)
    along = np.einsum("fi,fi->f", face_crosses(mesh), face_crosses(moved))
    assert along.min() > 0
