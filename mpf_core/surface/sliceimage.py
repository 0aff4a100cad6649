"""A field on a plane as a picture: diverging colours around 0, the zero level as a dark line.

Colours follow the square root of |value|, so that the inside of a shell thinner than a hundredth
of the box still shows its sign; faint lines at equal steps give the distances back.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from mpf_core.surface.drawing import (
    FAINT_INK,
    INK,
    color_table,
    font,
    number,
    png_bytes,
    round_length,
)

# Horizontal and vertical axis of the picture for a cut across each axis.
ACROSS = {"x": ("y", "z"), "y": ("x", "z"), "z": ("x", "y")}
SYMBOLS = {"phi": "φ", "theta": "θ", "r": "r", "P": "P"}
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

Extent = tuple[float, float, float, float]
Box = tuple[int, int, int, int]


@dataclass(frozen=True)
class Format:
    """How large a picture is, and how finely the field is sampled for it.

    pixels, samples: along the plot's longer side; scale: of what is written around the plot
    """

    pixels: int = 800
    samples: int = 448
    scale: float = 1.0

    def length(self, pixels: float) -> int:
        """A length beside the plot, given as in the largest format."""
        return round(pixels * self.scale)

    def font(self, size: int) -> ImageFont.FreeTypeFont:
        """The font of this size in the largest format."""
        return font(max(10, self.length(size)))


SINGLE = Format()  # a picture to look at by itself
STACK = Format(pixels=320, samples=129, scale=0.6)  # 96 of them in 4 s of one core


def slice_image(
    values: NDArray[np.floating],
    extent: Extent,
    *,
    axis: str,
    at: float,
    field: str = "phi",
    unit_label: str = "",
    limit: float | None = None,
    format: Format = SINGLE,
) -> bytes:
    """PNG of a field on a plane.

    values: (h, w), row 0 at the bottom; extent: left, right, bottom, top in input units;
    axis, at: the plane; limit: |value| of the strongest colours, the greatest one if not given.
    """
    values = np.asarray(values, dtype=np.float32)
    if limit is None:
        limit = float(np.abs(values).max())
    limit = limit if limit > 0 else 1.0
    margin, _, width, height = plot_box(extent, format)
    plot = _plot(_enlarged(values, (width, height)), limit)
    size = (width + format.length(130) + 2 * margin, height + format.length(66) + margin)
    canvas = Image.new("RGB", size, "white")
    canvas.paste(Image.fromarray(plot), (margin, margin))
    draw = ImageDraw.Draw(canvas)
    frame = (margin - 1, margin - 1, margin + width, margin + height)
    draw.rectangle(frame, outline=(190, 194, 200))
    unit = f" {unit_label}" if unit_label else ""
    _scale_bar(draw, frame, (extent[1] - extent[0]) / width, unit, format)
    place = f"{axis} = {number(at, round_length(_longest(extent) / 200))}{unit}"
    _caption(draw, frame, f"{SYMBOLS.get(field, field)} at {place}", ACROSS[axis], format)
    _color_bar(canvas, frame, limit, "" if field == "P" else unit, format)
    return png_bytes(canvas)


def plot_box(extent: Extent, format: Format = SINGLE) -> Box:
    """Where the plot lies in its picture: left, top, width and height in pixels."""
    pixels = format.pixels / _longest(extent)
    width = max(2, round((extent[1] - extent[0]) * pixels))
    height = max(2, round((extent[3] - extent[2]) * pixels))
    return format.length(18), format.length(18), width, height


def _longest(extent: Extent) -> float:
    return max(extent[1] - extent[0], extent[3] - extent[2])


def _enlarged(values: NDArray[np.float32], size: tuple[int, int]) -> NDArray[np.float32]:
    """The values at the picture's pixels (width, height), row 0 at the top."""
    image = Image.fromarray(np.ascontiguousarray(values[::-1]))
    return np.asarray(image.resize(size, Image.Resampling.BICUBIC))


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
    draw: ImageDraw.ImageDraw, frame: Box, pixel: float, unit: str, format: Format
) -> None:
    left, _, right, bottom = frame
    length = round_length(pixel * min(format.length(240), 0.6 * (right - left)))
    width = round(length / pixel)
    y = bottom + format.length(20)
    draw.rectangle((right - width, y, right, y + format.length(5)), fill=INK)
    text = number(length, length) + unit
    middle = right - width / 2, y + format.length(11)
    draw.text(middle, text, INK, format.font(17), anchor="ma")


def _caption(
    draw: ImageDraw.ImageDraw, frame: Box, text: str, across: tuple[str, str], format: Format
) -> None:
    left, bottom = frame[0], frame[3]
    draw.text((left, bottom + format.length(12)), text, INK, format.font(20))
    directions = f"{across[0]} to the right, {across[1]} up"
    draw.text((left, bottom + format.length(40)), directions, FAINT_INK, format.font(14))


def _color_bar(canvas: Image.Image, frame: Box, limit: float, unit: str, format: Format) -> None:
    """The scale of colours at the right of the plot, with the steps of the faint lines."""
    _, top, right, bottom = frame
    height = min(bottom - top - 1, format.length(420))
    if height < format.length(120):
        return
    width, tick = format.length(18), format.length(6)
    bar = _COLORS[np.linspace(len(_COLORS) - 1, 0, height).astype(np.int64)]
    strip = np.repeat(bar[:, None], width, axis=1)
    left = right + format.length(24)
    canvas.paste(Image.fromarray(strip), (left, top + 1))
    draw = ImageDraw.Draw(canvas)
    draw.rectangle((left - 1, top, left + width, top + height + 1), outline=(190, 194, 200))
    step = round_length(limit / 4)
    middle = top + 1 + height / 2
    for value in (-4 * step, -step, 0.0, step, 4 * step):
        y = middle - np.sign(value) * np.sqrt(abs(value) / limit) * height / 2
        draw.line((left + width, y, left + width + tick, y), fill=INK)
        text = number(value, step) + unit
        draw.text((left + width + tick + 5, y), text, INK, format.font(14), anchor="lm")
