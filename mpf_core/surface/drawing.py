"""What pictures share: a font that has the field's Greek letters, round lengths, colour scales."""

from __future__ import annotations

import io
import math
from functools import cache
from pathlib import Path

import matplotlib
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageFont

INK = (38, 42, 48)
FAINT_INK = (120, 126, 134)


@cache
def font(size: int) -> ImageFont.FreeTypeFont:
    """DejaVu Sans, which matplotlib carries."""
    path = Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"
    return ImageFont.truetype(str(path), size)


def round_length(about: float) -> float:
    """The largest of 1, 2, 5 × 10ᵏ that is not above `about` (> 0)."""
    power = 10.0 ** math.floor(math.log10(about))
    # The small surplus forgives 9.9999… for 10.
    return max(step for step in (0.1, 1, 2, 5) if step * power <= about * (1 + 1e-9)) * power


def number(value: float, step: float) -> str:
    """`value` with as many digits as tell multiples of `step` apart; a true minus sign."""
    digits = max(0, -math.floor(math.log10(step))) if step > 0 else 0
    text = f"{value:.{digits}f}" if digits <= 6 and abs(value) < 1e9 else f"{value:.3g}"
    if float(text) == 0:
        text = text.lstrip("-")
    return text.replace("-", "−")


def color_table(anchors: tuple[str, ...], size: int = 1024) -> NDArray[np.uint8]:
    """(size, 3) RGB, linear in between `anchors` (#rrggbb)."""
    colors = np.array([[int(a[k : k + 2], 16) for k in (1, 3, 5)] for a in anchors])
    at = np.linspace(0, len(anchors) - 1, size)
    channels = [np.interp(at, np.arange(len(anchors)), colors[:, k]) for k in range(3)]
    return np.stack(channels, axis=1).round().astype(np.uint8)


def png_bytes(image: Image.Image) -> bytes:
    """`image` as PNG."""
    stream = io.BytesIO()
    image.save(stream, format="PNG", compress_level=1)
    return stream.getvalue()
