"""The z-buffer against rays, and pictures against what must be in them."""

from __future__ import annotations

import igl
import numpy as np
import pytest

from mpf_core.cloud.pointcloud import PointCloud
from mpf_core.quality.raster import Camera, barycentric, rasterize
from mpf_core.quality.render import Scale, render, render_points, side_by_side
from mpf_core.surface.mesh import Mesh
from tests.mpf_core.quality.meshes import box, grid_sheet, icosphere, joined, moved


def scene() -> Mesh:
    return joined(box(2, 1, 0.5), moved(icosphere(2), 0.6, np.array([0.9, 0.3, 0.4])))


def test_each_pixel_sees_what_a_ray_hits_first() -> None:
    mesh = scene()
    camera = Camera.around(mesh.vertices, size=(160, 120))
    seen = rasterize(camera.project(mesh.vertices), mesh.faces, camera.size)
    rays = camera.unproject(np.ones((120, 160))).reshape(-1, 3).astype(np.float64) @ camera.axes
    tree = igl.AABB()
    tree.init(mesh.vertices, mesh.faces)
    eye = np.tile(camera.eye, (len(rays), 1))
    hit, distance, _ = tree.intersect_ray_first(mesh.vertices, mesh.faces, eye, rays)
    face, inverse = seen.face.ravel(), seen.inverse_depth.ravel()
    both = (face >= 0) & (hit >= 0)
    assert ((face >= 0) != (hit >= 0)).mean() < 2e-3
    assert (face != hit)[both].mean() < 5e-3
    assert np.abs(inverse[both] * distance[both] - 1).max() < 1e-3


def test_weights_give_back_the_place_on_the_triangle() -> None:
    mesh = scene()
    camera = Camera.around(mesh.vertices, size=(160, 120))
    screen = camera.project(mesh.vertices)
    seen = rasterize(screen, mesh.faces, camera.size)
    mask = seen.face >= 0
    weights = barycentric(screen, mesh.faces, seen)
    corners = mesh.vertices[mesh.faces[seen.face[mask]]]
    there = np.einsum("nk,nkd->nd", weights, corners)
    rows, columns = np.nonzero(mask)
    assert np.allclose(camera.project(there)[:, :2], np.stack([columns, rows], 1) + 0.5, atol=1e-6)


@pytest.mark.parametrize("up", ["y", "z"])
@pytest.mark.parametrize("azimuth", [-55.0, 0.0, 130.0])
def test_the_view_is_filled_and_not_left(up: str, azimuth: float) -> None:
    points = scene().vertices * [1, 5, 2] + [4e5, 5e6, 100]
    camera = Camera.around(points, size=(300, 200), azimuth=azimuth, up=up, margin=0.1)
    x, y, _ = camera.project(points).T
    assert x.min() >= 30 - 1e-6
    assert x.max() <= 270 + 1e-6
    assert y.min() >= 20 - 1e-6
    assert y.max() <= 180 + 1e-6
    assert np.ptp(x) == pytest.approx(240) or np.ptp(y) == pytest.approx(160)


def test_up_is_up() -> None:
    pole = np.array([[0.0, 0, 0], [0, 0, 1]])
    x, y, _ = Camera.around(pole, up="z").project(pole).T
    assert y[1] < y[0]
    assert x[0] == pytest.approx(x[1])
    camera = Camera.around(scene().vertices, azimuth=0, elevation=0, up="z")
    assert camera.axes[2] == pytest.approx([1, 0, 0])
    assert Camera.around(pole, azimuth=0, elevation=0, up="y").axes[2] == pytest.approx([0, 0, 1])
    with pytest.raises(ValueError, match="up"):
        Camera.around(pole, up="x")


def test_a_picture_of_a_ball() -> None:
    image = np.asarray(render(icosphere(4), size=(200, 150)))
    assert image.shape == (150, 200, 3)
    assert (image[0, 0] == 255).all()
    covered = (image < 250).any(axis=2).sum()
    # The silhouette is a disc of 88 % of the height.
    assert covered == pytest.approx(np.pi * (0.44 * 150) ** 2, rel=0.03)
    assert image[40, 80].mean() > image[110, 120].mean()


def test_front_and_back_of_a_sheet_differ() -> None:
    above = np.asarray(render(grid_sheet(5), size=(100, 80), elevation=60)).astype(int)
    below = np.asarray(render(grid_sheet(5), size=(100, 80), elevation=-60)).astype(int)
    assert above[40, 50, 2] > above[40, 50, 0]
    assert below[40, 50, 0] > below[40, 50, 2]


def test_colours_of_vertices_and_of_values() -> None:
    ball = icosphere(3)
    red = np.tile(np.array([[220, 30, 20]], np.uint8), (len(ball.vertices), 1))
    image = np.asarray(render(Mesh(ball.vertices, ball.faces, None, red), size=(100, 80)))
    assert image[40, 50, 0] > 2 * int(image[40, 50, 1])
    scale = Scale(np.abs(ball.vertices[:, 2]), limits=(0, 1), label="height")
    shown = np.asarray(render(ball, size=(300, 240), scale=scale))
    plain = np.asarray(render(ball, size=(300, 240)))
    assert (shown != plain)[200:, 200:].any()
    assert Scale(np.zeros(4)).colors().shape == (4, 3)


def test_points_in_their_colours_on_nothing() -> None:
    points = icosphere(4).vertices
    green = np.tile(np.array([[20, 200, 30]], np.uint8), (len(points), 1))
    image = np.asarray(
        render_points(PointCloud(points, colors=green), size=(120, 90), transparent=True)
    )
    assert image.shape == (90, 120, 4)
    assert image[0, 0, 3] == 0
    assert image[45, 60, 3] > 0
    assert image[45, 60, 1] > image[45, 60, 0]


def test_side_by_side() -> None:
    picture = render(icosphere(1), size=(80, 60))
    sheet = side_by_side([picture, picture], ["before", "after"])
    assert sheet.width == 176
    assert sheet.height > 60
    with pytest.raises(ValueError, match="caption"):
        side_by_side([picture], [])
