"""Floaters, colours, normals and the way back to the input's frame."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mpf_core.cloud.normalize import Similarity
from mpf_core.surface.finish import finish, without_floaters
from mpf_core.surface.isosurface import Grid, Isosurface
from tests.mpf_core.clouds import sphere

SAMPLES = sphere(800, 0.5)
IDENTITY = Similarity(np.zeros(3), 1.0)


def ball(radius: float, at: float = 0.0) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=radius)
    return np.asarray(mesh.vertices) + np.array([at, 0, 0]), np.asarray(mesh.faces, dtype=np.int64)


def surface(*parts: tuple[NDArray[np.float64], NDArray[np.int64]]) -> Isosurface:
    starts = np.cumsum([0, *(len(v) for v, _ in parts)])
    faces = [f + start for (_, f), start in zip(parts, starts, strict=False)]
    grid = Grid(np.zeros(3), 1.0, np.ones(3, dtype=np.int64), 0)
    return Isosurface(np.concatenate([v for v, _ in parts]), np.concatenate(faces), grid, 0, 0)


def radial(x: NDArray[np.float64]) -> NDArray[np.float32]:
    return (3 * x).astype(np.float32)


def test_components_far_from_every_sample_go() -> None:
    whole = surface(ball(0.05, 0.9), ball(0.5), ball(0.02))
    vertices, faces, removed = without_floaters(whole, cKDTree(SAMPLES), 0.1)
    assert removed == 2
    expected = ball(0.5)
    assert np.array_equal(vertices, expected[0])
    assert np.array_equal(faces, expected[1])


def test_small_components_go_by_the_samples_that_they_account_for() -> None:
    few = np.concatenate([SAMPLES, 0.9 + 0.01 * SAMPLES[:12]])
    whole = surface(ball(0.5), (ball(0.02)[0] + 0.9, ball(0.02)[1]))
    for least, removed in ((0, 0), (12, 0), (13, 1), (10_000, 1)):
        _, faces, found = without_floaters(whole, cKDTree(few), 0.1, least=least)
        assert found == removed
        assert len(faces) == len(whole.faces) // (1 + removed)


def test_a_component_that_touches_the_band_stays_whole() -> None:
    whole = surface(ball(0.5), ball(0.2, 0.85))
    _, faces, removed = without_floaters(whole, cKDTree(SAMPLES), 0.1)
    assert removed == 0
    assert faces is whole.faces


def test_if_all_are_far_all_stay() -> None:
    whole = surface(ball(0.05, 3.0), ball(0.05, -3.0))
    vertices, _, removed = without_floaters(whole, cKDTree(SAMPLES), 0.1)
    assert removed == 0
    assert len(vertices) == len(whole.vertices)


def test_normals_are_the_gradient_at_length_one() -> None:
    vertices, faces = ball(0.5)
    mesh = finish(vertices, faces, radial, IDENTITY, None)
    assert mesh.normals == pytest.approx(vertices / 0.5, abs=1e-6)
    assert mesh.colors is None


def test_colours_are_those_of_the_samples_nearby() -> None:
    colors = np.where(SAMPLES[:, :1] > 0, [[250, 10, 0]], [[0, 20, 255]]).astype(np.uint8)
    vertices, faces = ball(0.5)
    mesh = finish(vertices, faces, radial, IDENTITY, (cKDTree(SAMPLES), colors))
    assert mesh.colors is not None
    assert mesh.colors.dtype == np.uint8
    assert (mesh.colors[vertices[:, 0] > 0.1] == [250, 10, 0]).all()
    assert (mesh.colors[vertices[:, 0] < -0.1] == [0, 20, 255]).all()


def test_a_vertex_on_a_sample_has_its_colour() -> None:
    colors = np.random.default_rng(0).integers(0, 256, size=(800, 3)).astype(np.uint8)
    faces = np.array([[0, 1, 2]])
    mesh = finish(SAMPLES[:3], faces, radial, IDENTITY, (cKDTree(SAMPLES), colors))
    assert np.array_equal(mesh.colors, colors[:3])


def test_utm_coordinates_keep_their_micrometres() -> None:
    """Eastings and northings have seven digits before the point."""
    utm = SAMPLES * 20 + [691_607.25, 5_334_760.5, 512.125]
    similarity = Similarity.of(utm)
    vertices, faces = ball(1.0)
    mesh = finish(vertices, faces, radial, similarity, None)
    assert mesh.vertices.dtype == np.float64
    back = similarity.to_normalised(mesh.vertices)
    assert np.abs(back - vertices).max() / similarity.scale < 1e-6
    assert np.abs(mesh.vertices.mean(0) - similarity.center).max() < 1e-6
