"""Slices of a field as pictures: diverging colours around 0, the zero level as a dark line.

Colours follow the square root of |value|, so that the inside of a shell thinner than a hundredth
of the box still shows its sign; faint lines at equal steps give the distances back.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from mpf_core.files import write_atomically
from mpf_core.surface.drawing import (
    FAINT_INK,
    INK,
    color_table,
    font,
    number,
    png_bytes,
    round_length,
)

AXES = ("x", "y", "z")
# Horizontal and vertical axis of the picture for a cut across each axis.
ACROSS = {"x": ("y", "z"), "y": ("x", "z"), "z": ("x", "y")}
SYMBOLS = {"phi": "φ", "theta": "θ", "r": "r", "P": "P"}
LIMIT = 0.5
RESOLUTION = 448
_LONG_SIDE, _RIGHT, _BOTTOM, _MARGIN = 800, 130, 66, 18
_LINE = (21, 24, 28)
_COLORS = color_table(
    (
        "#143f6b",
        "#24669f",
        "#3f8fc4",
        "#9cc9e3",
        "#fbfaf6",
        "#f4c19b",
        "#dd7f4f",
        "#b4492b",
        "#7d2715",
    )
)

Evaluate = Callable[[NDArray[np.float64]], NDArray[np.floating]]
Extent = tuple[float, float, float, float]


class Frame(Protocol):
    """What is used of `mpf_core.cloud.normalize.Similarity`."""

    @property
    def scale(self) -> float: ...
    def to_input(self, points: NDArray[np.floating]) -> NDArray[np.float64]: ...


@dataclass(frozen=True)
class Slice:
    """One written picture: the cut `axis` = `at`, in the input's units."""

    axis: str
    index: int
    at: float
    path: Path


def write_slices(
    evaluate: Evaluate,
    similarity: Frame,
    box: NDArray[np.float64],
    count_per_axis: int,
    directory: str | Path,
    *,
    field: str = "phi",
    resolution: int = RESOLUTION,
    unit_label: str = "",
) -> list[Slice]:
    """Write `slices/{axis}/{index}.png` under `directory`, evenly spaced over `box`.

    evaluate: field values (n,) at normalised points (n, 3); box: (2, 3) normalised corners;
    resolution: samples along the picture's longer side. Lengths shown are in the input's units.
    """
    written = []
    for axis in AXES:
        for index in range(count_per_axis):
            share = (index + 0.5) / count_per_axis
            place = AXES.index(axis)
            at = float(box[0, place] + share * (box[1, place] - box[0, place]))
            path = Path(directory) / "slices" / axis / f"{index}.png"
            path.parent.mkdir(parents=True, exist_ok=True)
            picture, position = cut(
                evaluate, similarity, box, axis, at,
                field=field, resolution=resolution, unit_label=unit_label,
            )  # fmt: skip
            write_atomically(path, picture)
            written.append(Slice(axis, index, position, path))
    return written


def cut(
    evaluate: Evaluate,
    similarity: Frame,
    box: NDArray[np.float64],
    axis: str,
    at: float,
    *,
    field: str = "phi",
    resolution: int = RESOLUTION,
    unit_label: str = "",
) -> tuple[bytes, float]:
    """PNG of the field across `axis` at `at` (normalised), and that position in input units."""
    place = AXES.index(axis)
    right, up = (AXES.index(name) for name in ACROSS[axis])
    sides = box[1] - box[0]
    step = max(sides[right], sides[up]) / (resolution - 1)
    columns, rows = (2 * max(1, round(sides[k] / step / 2)) + 1 for k in (right, up))
    points = np.empty((rows, columns, 3))
    points[..., place] = at
    points[..., right] = np.linspace(box[0, right], box[1, right], columns)
    points[..., up] = np.linspace(box[0, up], box[1, up], rows)[:, None]
    # Far from the zero level a field is smooth; P is where it is saturated.
    values = _refined(evaluate, points, below=0.98 if field == "P" else 4 * step)
    corners = similarity.to_input(points[[0, -1], [0, -1]])
    # Fields but P are lengths; the frame's scale turns them into the input's units.
    length = 1.0 if field == "P" else 1.0 / similarity.scale
    picture = slice_image(
        values * length,
        (*corners[:, right], *corners[:, up]),
        axis=axis,
        at=float(corners[0, place]),
        field=field,
        unit_label=unit_label,
        limit=1.0 if field == "P" else LIMIT * length,
    )
    return picture, float(corners[0, place])


def _refined(evaluate: Evaluate, points: NDArray[np.float64], below: float) -> NDArray[np.float64]:
    """(h, w) field at `points` (h, w, 3), h and w odd: every second one in both directions, those
    in between where |value| may be less than `below`, the mean of their neighbours elsewhere."""
    values = np.empty(points.shape[:2])
    values[::2, ::2] = evaluate(points[::2, ::2].reshape(-1, 3)).reshape(values[::2, ::2].shape)
    values[1::2, ::2] = (values[:-1:2, ::2] + values[2::2, ::2]) / 2
    values[:, 1::2] = (values[:, :-1:2] + values[:, 2::2]) / 2
    near = np.abs(values) < below
    near[::2, ::2] = False
    if near.any():
        values[near] = evaluate(points[near])
    return values


def slice_image(
    values: NDArray[np.floating],
    extent: Extent,
    *,
    axis: str,
    at: float,
    field: str = "phi",
    unit_label: str = "",
    limit: float | None = None,
) -> bytes:
    """PNG of a field on a plane.

    values: (h, w), row 0 at the bottom; extent: left, right, bottom, top in input units;
    axis, at: the plane; limit: |value| of the strongest colours, the greatest one if not given.
    """
    values = np.asarray(values, dtype=np.float32)
    if limit is None:
        limit = float(np.abs(values).max())
    limit = limit if limit > 0 else 1.0
    plot = _plot(_enlarged(values, extent), limit)
    height, width = plot.shape[:2]
    canvas = Image.new("RGB", (width + _RIGHT + 2 * _MARGIN, height + _BOTTOM + _MARGIN), "white")
    canvas.paste(Image.fromarray(plot), (_MARGIN, _MARGIN))
    draw = ImageDraw.Draw(canvas)
    frame = (_MARGIN - 1, _MARGIN - 1, _MARGIN + width, _MARGIN + height)
    draw.rectangle(frame, outline=(190, 194, 200))
    unit = f" {unit_label}" if unit_label else ""
    _scale_bar(draw, frame, (extent[1] - extent[0]) / width, unit)
    _caption(draw, frame, axis, number(at, round_length(_longest(extent) / 200)) + unit, field)
    _color_bar(canvas, frame, limit, "" if field == "P" else unit)
    return png_bytes(canvas)


def _longest(extent: Extent) -> float:
    return max(extent[1] - extent[0], extent[3] - extent[2])


def _enlarged(values: NDArray[np.float32], extent: Extent) -> NDArray[np.float32]:
    """The values at the picture's pixels, row 0 at the top."""
    pixels = _LONG_SIDE / _longest(extent)
    width = max(2, round((extent[1] - extent[0]) * pixels))
    height = max(2, round((extent[3] - extent[2]) * pixels))
    image = Image.fromarray(np.ascontiguousarray(values[::-1]))
    return np.asarray(image.resize((width, height), Image.Resampling.BICUBIC))


def _plot(values: NDArray[np.float32], limit: float) -> NDArray[np.uint8]:
    """(h, w, 3) colours of the values with their level lines."""
    last = len(_COLORS) - 1
    shade = np.copysign(np.sqrt(np.minimum(np.abs(values) * (1 / limit), 1)), values)
    picture = np.take(_COLORS, ((shade + 1) * (last / 2) + 0.5).astype(np.int16), axis=0)
    # |value| over its change per pixel is the distance to the level line in pixels.
    rise = np.hypot(*np.gradient(values)) + np.float32(1e-12 * limit)
    step = round_length(limit / 4)
    off_step = np.abs(values - np.rint(values * (1 / step)) * step) / rise
    faint = 0.16 * np.clip(1 - off_step, 0, 1)
    dark = np.clip(2.1 - np.abs(values) / rise, 0, 1)
    cover = np.maximum(faint, dark)
    lines = cover > 0
    weight = cover[lines][:, None]
    picture[lines] = picture[lines] * (1 - weight) + np.array(_LINE) * weight
    return picture


def _scale_bar(
    draw: ImageDraw.ImageDraw, frame: tuple[int, int, int, int], pixel: float, unit: str
) -> None:
    left, _, right, bottom = frame
    length = round_length(pixel * min(240, 0.6 * (right - left)))
    width = round(length / pixel)
    y = bottom + 20
    draw.rectangle((right - width, y, right, y + 5), fill=INK)
    text = number(length, length) + unit
    draw.text((right - width / 2, y + 11), text, INK, font(17), anchor="ma")


def _caption(
    draw: ImageDraw.ImageDraw, frame: tuple[int, int, int, int], axis: str, at: str, field: str
) -> None:
    left, bottom = frame[0], frame[3]
    draw.text((left, bottom + 12), f"{SYMBOLS.get(field, field)} at {axis} = {at}", INK, font(20))
    right, up = ACROSS[axis]
    draw.text((left, bottom + 40), f"{right} to the right, {up} up", FAINT_INK, font(14))


def _color_bar(
    canvas: Image.Image, frame: tuple[int, int, int, int], limit: float, unit: str
) -> None:
    """The scale of colours at the right of the plot, with the steps of the faint lines."""
    _, top, right, bottom = frame
    height = min(bottom - top - 1, 420)
    if height < 120:
        return
    bar = _COLORS[np.linspace(len(_COLORS) - 1, 0, height).astype(np.int64)]
    strip = np.repeat(bar[:, None], 18, axis=1)
    left = right + 24
    canvas.paste(Image.fromarray(strip), (left, top + 1))
    draw = ImageDraw.Draw(canvas)
    draw.rectangle((left - 1, top, left + 18, top + height + 1), outline=(190, 194, 200))
    step = round_length(limit / 4)
    middle = top + 1 + height / 2
    for value in (-4 * step, -step, 0.0, step, 4 * step):
        y = middle - np.sign(value) * np.sqrt(abs(value) / limit) * height / 2
        draw.line((left + 18, y, left + 24, y), fill=INK)
        draw.text((left + 29, y), number(value, step) + unit, INK, font(14), anchor="lm")
