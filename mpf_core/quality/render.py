"""Pictures of meshes and clouds, without a display: the same camera and light for every method."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import igl
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from mpf_core.cloud.pointcloud import PointCloud
from mpf_core.quality.raster import Camera, Visible, barycentric, rasterize
from mpf_core.quality.shading import lit, open_sky, to_linear, to_srgb
from mpf_core.surface.drawing import INK, color_table, font, number, round_length
from mpf_core.surface.mesh import Mesh

FRONT, BACK = (0.70, 0.77, 0.86), (0.93, 0.76, 0.55)
POINTS = (0.48, 0.59, 0.74)
CREASE_DEGREES = 38.0
_SUPERSAMPLING = 2
_ERRORS = color_table(("#dfe7ea", "#f7e3a1", "#f3a953", "#d9572b", "#8c1d2c", "#3f0a25"))


@dataclass(frozen=True)
class Scale:
    """A number at each vertex, to be shown as a colour.

    values: (v,) float; limits: those of the colours, 0 and the 98th percentile if not given;
    label: what and in which unit, for the legend
    """

    values: NDArray[np.floating]
    limits: tuple[float, float] | None = None
    label: str = ""

    def range(self) -> tuple[float, float]:
        """The limits of the colours, never equal."""
        low, high = self.limits or (0.0, float(np.percentile(self.values, 98)))
        return (low, high) if high > low else (low, low + 1.0)

    def colors(self) -> NDArray[np.float32]:
        """(v, 3) sRGB in [0, 1]."""
        low, high = self.range()
        share = np.clip((np.asarray(self.values) - low) / (high - low), 0, 1)
        return (_ERRORS[(share * (len(_ERRORS) - 1)).astype(np.int64)] / 255).astype(np.float32)


def render(
    mesh: Mesh,
    *,
    size: tuple[int, int] = (1200, 900),
    azimuth: float = -55.0,
    elevation: float = 24.0,
    up: str = "z",
    camera: Camera | None = None,
    scale: Scale | None = None,
    transparent: bool = False,
) -> Image.Image:
    """A lit picture of `mesh`; the back of its triangles is sand-coloured where the front is blue.

    `camera` (see `Camera.around`) overrides size and angles, for several meshes in one view. The
    mesh's own colours are used if it has any, those of `scale`, with a legend, if that is given.
    """
    if camera is None:
        used = mesh.vertices[np.unique(mesh.faces)]
        camera = Camera.around(used, size=size, azimuth=azimuth, elevation=elevation, up=up)
    fine = camera.enlarged(_SUPERSAMPLING)
    screen = fine.project(mesh.vertices)
    seen = rasterize(screen, mesh.faces, fine.size)
    mask = seen.face >= 0
    face, weights = seen.face[mask], barycentric(screen, mesh.faces, seen)
    normals = _corner_normals(mesh)[face]
    normal = np.einsum("nk,nkd->nd", weights, normals) @ camera.axes.T
    normal, turned = _towards_viewer(normal, fine, seen)
    color = _surface_colors(mesh, scale, face, weights, turned)
    picture = _picture(fine, seen, normal, to_linear(color), transparent)
    if scale is not None:
        _legend(picture, scale)
    return picture


def render_points(
    cloud: PointCloud,
    *,
    size: tuple[int, int] = (1200, 900),
    azimuth: float = -55.0,
    elevation: float = 24.0,
    up: str = "z",
    camera: Camera | None = None,
    radius: float = 1.6,
    transparent: bool = False,
) -> Image.Image:
    """A picture of a cloud: small balls of `radius` pixels, in its colours if it has any."""
    if camera is None:
        camera = Camera.around(cloud.points, size=size, azimuth=azimuth, elevation=elevation, up=up)
    fine = camera.enlarged(_SUPERSAMPLING)
    seen, normal = _balls(fine.project(cloud.points), fine.size, radius * _SUPERSAMPLING)
    index = seen.face[seen.face >= 0]
    color = np.tile(np.array(POINTS, np.float32), (len(index), 1))
    if cloud.colors is not None:
        color = (cloud.colors[index] / 255).astype(np.float32)
    return _picture(fine, seen, normal, to_linear(color), transparent)


def side_by_side(
    images: Sequence[Image.Image], captions: Sequence[str], *, gap: int = 16
) -> Image.Image:
    """Pictures in one row on white, each with its caption below."""
    if len(images) != len(captions) or not images:
        raise ValueError("each picture needs one caption")
    text = max(14, round(images[0].width / 42))
    height = max(image.height for image in images)
    width = sum(image.width for image in images) + gap * (len(images) - 1)
    sheet = Image.new("RGB", (width, height + round(2.4 * text)), "white")
    draw = ImageDraw.Draw(sheet)
    left = 0
    for image, caption in zip(images, captions, strict=True):
        shown = image.convert("RGBA")
        sheet.paste(shown, (left, 0), shown)
        middle = (left + image.width / 2, height + 0.5 * text)
        draw.text(middle, caption, INK, font(text), anchor="ma")
        left += image.width + gap
    return sheet


def _corner_normals(mesh: Mesh) -> NDArray[np.float64]:
    """(f, 3, 3) normals of each triangle's corners, smooth but for creases."""
    corner = igl.per_corner_normals(
        np.ascontiguousarray(mesh.vertices), np.ascontiguousarray(mesh.faces), CREASE_DEGREES
    )
    return np.asarray(np.nan_to_num(corner)).reshape(-1, 3, 3)


def _towards_viewer(
    normal: NDArray[np.float64], camera: Camera, seen: Visible
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Unit normals turned to the viewer, and which were turned: those see the triangle's back."""
    depth = 1 / np.maximum(seen.inverse_depth, 1e-9)
    away = camera.unproject(depth)[seen.face >= 0]
    turned = np.asarray(np.einsum("nd,nd->n", normal, away) > 0)
    normal = np.where(turned[:, None], -normal, normal)
    length = np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    return (normal / length).astype(np.float32), turned


def _surface_colors(
    mesh: Mesh,
    scale: Scale | None,
    face: NDArray[np.int32],
    weights: NDArray[np.float64],
    turned: NDArray[np.bool_],
) -> NDArray[np.float32]:
    at_vertices = None
    if scale is not None:
        at_vertices = scale.colors()
    elif mesh.colors is not None:
        at_vertices = (mesh.colors / 255).astype(np.float32)
    if at_vertices is None:
        sides = np.array([FRONT, BACK], np.float32)
        return sides[turned.astype(np.int64)]
    mixed = np.einsum("nk,nkd->nd", weights, at_vertices[mesh.faces[face]])
    return np.asarray(mixed, dtype=np.float32)


def _picture(
    camera: Camera,
    seen: Visible,
    normal: NDArray[np.float32],
    color: NDArray[np.float32],
    transparent: bool,
) -> Image.Image:
    """Light on what is seen, and the supersampled image brought down to its size."""
    mask = seen.face >= 0
    position = camera.unproject(np.where(mask, 1 / np.maximum(seen.inverse_depth, 1e-9), 0))
    normals = np.zeros(position.shape, np.float32)
    normals[mask] = normal
    # Ambient light is soft: half the pixels are enough for it.
    coarse = (slice(None, None, 2), slice(None, None, 2))
    reach = max(camera.size) // 2 // 22
    sky = open_sky(position[coarse], normals[coarse], mask[coarse], reach)
    sky = np.repeat(np.repeat(sky, 2, axis=0), 2, axis=1)[: mask.shape[0], : mask.shape[1]]
    image = np.zeros((*mask.shape, 4), np.float32)
    image[mask, :3] = lit(color, normal, sky[mask])
    image[mask, 3] = 1
    height, width = (side // _SUPERSAMPLING for side in mask.shape)
    small = image.reshape(height, _SUPERSAMPLING, width, _SUPERSAMPLING, 4).mean(axis=(1, 3))
    cover = small[..., 3:]
    if transparent:
        light = to_srgb(small[..., :3] / np.maximum(cover, 1e-6))
        return Image.fromarray(_bytes(np.concatenate([light, cover], axis=2)), "RGBA")
    return Image.fromarray(_bytes(to_srgb(small[..., :3] + (1 - cover))), "RGB")


def _bytes(values: NDArray[np.float32]) -> NDArray[np.uint8]:
    return (values * 255 + 0.5).astype(np.uint8)


def _balls(
    screen: NDArray[np.float64], size: tuple[int, int], radius: float
) -> tuple[Visible, NDArray[np.float32]]:
    """The nearest ball at each pixel, and (k, 3) normals of what is seen of them."""
    width, height = size
    reach = int(np.ceil(radius))
    nearest = np.zeros(width * height, np.float32)
    point = np.full(width * height, -1, np.int32)
    normals = np.zeros((width * height, 3), np.float32)
    base = np.floor(screen[:, :2]).astype(np.int64)
    for dy in range(-reach, reach + 1):
        for dx in range(-reach, reach + 1):
            pixel = base + np.array([dx, dy])
            off = (pixel + 0.5 - screen[:, :2]) / radius
            square = np.einsum("nd,nd->n", off, off)
            inside = (square < 1) & (pixel >= 0).all(axis=1) & (pixel < (width, height)).all(axis=1)
            index = np.flatnonzero(inside)
            at = pixel[index, 1] * width + pixel[index, 0]
            bulge = np.sqrt(1 - square[index])
            # A ball bulges towards the viewer; its depth in pixels is small against its distance.
            inverse = (screen[index, 2] * (1 + 1e-4 * bulge)).astype(np.float32)
            np.maximum.at(nearest, at, inverse)
            front = inverse == nearest[at]
            at, index = at[front], index[front]
            point[at] = index
            normals[at] = np.stack([off[index, 0], -off[index, 1], bulge[front]], axis=1)
    shape = (height, width)
    seen = Visible(point.reshape(shape), nearest.reshape(shape))
    return seen, normals[point >= 0]


def _legend(picture: Image.Image, scale: Scale) -> None:
    """A bar of the colours along the lower right, with its limits and label."""
    low, high = scale.range()
    width, text = round(0.26 * picture.width), max(13, round(picture.width / 70))
    left, top = picture.width - width - 2 * text, picture.height - round(3.6 * text)
    bar = _ERRORS[np.linspace(0, len(_ERRORS) - 1, width).astype(np.int64)]
    picture.paste(Image.fromarray(np.repeat(bar[None], text // 2 + 2, axis=0)), (left, top))
    draw = ImageDraw.Draw(picture)
    below = top + text // 2 + 6
    step = round_length((high - low) / 10)
    draw.text((left, below), number(low, step), INK, font(text), anchor="la")
    draw.text((left + width, below), "≥ " + number(high, step), INK, font(text), anchor="ra")
    draw.text((left + width / 2, top - 4), scale.label, INK, font(text), anchor="md")
