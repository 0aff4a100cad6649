"""A camera, and which triangle is seen in each pixel: a z-buffer over arrays, no display needed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
_CANDIDATES_AT_ONCE = 1_500_000


@dataclass(frozen=True)
class Camera:
    """A perspective camera.

    axes: (3, 3) rows: to the right, up and towards the viewer; eye: (3,) its place;
    focal: pixels; principal: (2,) pixel that the viewing axis meets; size: width, height in pixels
    """

    axes: Floats
    eye: Floats
    focal: float
    principal: Floats
    size: tuple[int, int]

    @classmethod
    def around(
        cls,
        points: Floats,
        *,
        size: tuple[int, int] = (1200, 900),
        azimuth: float = -55.0,
        elevation: float = 24.0,
        up: str = "z",
        margin: float = 0.06,
        field_of_view: float = 24.0,
    ) -> Camera:
        """The camera that sees `points` (n, 3) as large as fits, from angles in degrees.

        Azimuth turns about the axis `up` ("y" or "z"): 0 looks from +x (from +z when y is up).
        """
        axes = _axes(azimuth, elevation, up)
        low, high = points.min(axis=0), points.max(axis=0)
        middle = (low + high) / 2
        x, y, z = axes @ (points - middle).T
        half = np.array(size) / 2
        focal = half[1] / np.tan(np.radians(field_of_view / 2))
        distance = float(np.max(z + np.maximum(np.abs(x) / half[0], np.abs(y) / half[1]) * focal))
        reach = float(np.linalg.norm(high - low)) or 1.0
        distance = max(distance, float(z.max()) + 0.5 * reach)
        flat = np.stack([x, -y]) / (distance - z)
        near, far = flat.min(axis=1), flat.max(axis=1)
        room = np.array(size) * (1 - 2 * margin)
        focal = float(np.min(room / np.maximum(far - near, 1e-9 * reach / distance)))
        principal = half - focal * (near + far) / 2
        return cls(axes, middle + distance * axes[2], focal, principal, size)

    def enlarged(self, factor: int) -> Camera:
        """The same view on `factor` times as many pixels a side."""
        size = (self.size[0] * factor, self.size[1] * factor)
        return Camera(self.axes, self.eye, self.focal * factor, self.principal * factor, size)

    def project(self, points: Floats) -> Floats:
        """(n, 3): pixel x (rightwards), pixel y (downwards), 1 / depth; depth must be positive."""
        x, y, z = self.axes @ (points - self.eye).T
        depth = np.maximum(-z, 1e-9)
        return np.stack(
            [
                self.principal[0] + self.focal * x / depth,
                self.principal[1] - self.focal * y / depth,
                1 / depth,
            ],
            axis=1,
        )

    def unproject(self, depth: NDArray[np.floating]) -> NDArray[np.float32]:
        """(h, w, 3) camera coordinates (right, up, towards the viewer) of an image of depths."""
        height, width = depth.shape
        x = (np.arange(width) + 0.5 - self.principal[0]) / self.focal
        y = (self.principal[1] - np.arange(height) - 0.5) / self.focal
        return np.stack([x * depth, y[:, None] * depth, -depth], axis=2).astype(np.float32)


@dataclass(frozen=True)
class Visible:
    """What each pixel sees: face (h, w) int32, -1 for nothing, and 1 / depth (h, w) float32."""

    face: NDArray[np.int32]
    inverse_depth: NDArray[np.float32]


def rasterize(screen: Floats, faces: NDArray[np.int64], size: tuple[int, int]) -> Visible:
    """The nearest triangle at each pixel's centre.

    screen: (v, 3) vertices as `Camera.project` gives them; both sides of a triangle are seen.
    """
    width, height = size
    nearest = np.zeros(width * height, np.float32)
    seen = np.full(width * height, -1, np.int32)
    for face, pixel, inverse_depth in _candidates(screen, faces, size):
        np.maximum.at(nearest, pixel, inverse_depth)
        front = inverse_depth == nearest[pixel]
        seen[pixel[front]] = face[front]
    return Visible(seen.reshape(height, width), nearest.reshape(height, width))


def barycentric(screen: Floats, faces: NDArray[np.int64], seen: Visible) -> Floats:
    """(k, 3) weights of the corners at each pixel that sees a triangle, right in perspective."""
    rows, columns = np.nonzero(seen.face >= 0)
    corners = screen[faces[seen.face[rows, columns]]]
    pixel = np.stack([columns + 0.5, rows + 0.5], axis=1)
    a, b, c = (corners[:, k, :2] - pixel for k in range(3))
    weights = np.stack([_turn(b, c), _turn(c, a), _turn(a, b)], axis=1) * corners[:, :, 2]
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))


def _axes(azimuth: float, elevation: float, up: str) -> Floats:
    turn, rise = np.radians(azimuth), np.radians(elevation)
    toward = np.array([np.cos(turn) * np.cos(rise), np.sin(turn) * np.cos(rise), np.sin(rise)])
    right = np.array([-np.sin(turn), np.cos(turn), 0.0])
    axes = np.stack([right, np.cross(toward, right), toward])
    if up == "z":
        return axes
    if up == "y":
        return axes[:, [1, 2, 0]]
    raise ValueError(f"up is {up!r}: it must be 'y' or 'z'")


def _turn(a: Floats, b: Floats) -> Floats:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def _candidates(
    screen: Floats, faces: NDArray[np.int64], size: tuple[int, int]
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float32]]]:
    """Batches of (face, pixel, 1 / depth) over the pixels that triangles cover."""
    corners = screen[faces]
    a, b, c = (corners[:, k, :2] for k in range(3))
    low = np.ceil(np.minimum(np.minimum(a, b), c) - 0.5).clip(0, size).astype(np.int64)
    high = np.floor(np.maximum(np.maximum(a, b), c) - 0.5).clip(-1, np.array(size) - 1)
    spans = np.maximum(high.astype(np.int64) - low + 1, 0)
    counts = spans.prod(axis=1)
    area = _turn(b - a, c - a)
    kept = np.flatnonzero((counts > 0) & (area != 0))
    # Large triangles in batches of their own would not fit: cut by the running count.
    batches = np.cumsum(counts[kept]) // _CANDIDATES_AT_ONCE
    for part in np.split(kept, np.flatnonzero(np.diff(batches)) + 1):
        yield from _covered(part, corners, low, spans, area, size[0])


def _covered(
    part: NDArray[np.int64],
    corners: Floats,
    low: NDArray[np.int64],
    spans: NDArray[np.int64],
    area: Floats,
    width: int,
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float32]]]:
    if len(part) == 0:
        return
    # Weights of corners 1 and 2 and 1 / depth are affine in the pixel: value + along · steps.
    origin = low[part] + 0.5
    a, b, c = (corners[part, k, :2] - origin for k in range(3))
    scale = 1 / area[part]
    at_1, at_2 = _turn(c, a) * scale, _turn(a, b) * scale
    step_1 = np.stack([c[:, 1] - a[:, 1], a[:, 0] - c[:, 0]], axis=1) * scale[:, None]
    step_2 = np.stack([a[:, 1] - b[:, 1], b[:, 0] - a[:, 0]], axis=1) * scale[:, None]
    depths = corners[part, :, 2]
    d1, d2 = depths[:, 1] - depths[:, 0], depths[:, 2] - depths[:, 0]
    counts = spans[part].prod(axis=1)
    index = np.repeat(np.arange(len(part)), counts)
    inside_box = np.arange(len(index)) - np.repeat(np.cumsum(counts) - counts, counts)
    y, x = np.divmod(inside_box, spans[part, 0][index])
    # float32 is enough: steps are counted from the corner of the triangle's own box.
    plane = np.stack([at_1, *step_1.T, at_2, *step_2.T], axis=1).astype(np.float32)[index]
    w1 = plane[:, 0] + plane[:, 1] * x + plane[:, 2] * y
    w2 = plane[:, 3] + plane[:, 4] * x + plane[:, 5] * y
    tolerance = np.float32(-1e-5)
    inside = (w1 >= tolerance) & (w2 >= tolerance) & (w1 + w2 <= 1 - tolerance)
    index, x, y, w1, w2 = index[inside], x[inside], y[inside], w1[inside], w2[inside]
    face = part[index]
    inverse_depth = (depths[index, 0] + d1[index] * w1 + d2[index] * w2).astype(np.float32)
    yield face, (low[face, 1] + y) * width + low[face, 0] + x, inverse_depth
