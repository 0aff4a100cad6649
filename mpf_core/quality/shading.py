"""Light on what a camera sees: two lamps, a sky, and the dark of corners."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

Image32 = NDArray[np.float32]

# In camera coordinates: right, up, towards the viewer.
_KEY = np.array([-0.45, 0.62, 0.64], np.float32)
_FILL = np.array([0.80, 0.05, 0.60], np.float32)
_SPIRAL = 14


def lit(color: Image32, normal: Image32, open_sky: Image32) -> Image32:
    """(k, 3) linear light from surfaces of `color` (k, 3), seen where `normal` (k, 3) says.

    normal: unit, in camera coordinates, towards the viewer; open_sky: (k,) share not hidden by
    neighbours.
    """
    key = np.maximum(normal @ (_KEY / np.linalg.norm(_KEY)), 0)
    fill = np.maximum(normal @ (_FILL / np.linalg.norm(_FILL)), 0)
    sky = 0.5 + 0.5 * normal[:, 1]
    half_way = _KEY / np.linalg.norm(_KEY) + np.array([0, 0, 1], np.float32)
    shine = np.maximum(normal @ (half_way / np.linalg.norm(half_way)), 0) ** 40
    light = (0.20 + 0.22 * sky) * open_sky + (0.66 * key + 0.16 * fill) * (0.35 + 0.65 * open_sky)
    return np.asarray(color * light[:, None] + (0.06 * shine * open_sky)[:, None])


def open_sky(position: Image32, normal: Image32, seen: NDArray[np.bool_], reach: int) -> Image32:
    """(h, w) share of the sky that what is seen nearby leaves open: 1 on a plane, less in corners.

    position, normal: (h, w, 3) in camera coordinates; reach: pixels looked around.
    """
    hidden = np.zeros(seen.shape, np.float32)
    # The reach in space is that of the middle depth, so that far things do not darken near ones.
    scale = float(np.median(-position[seen][:, 2])) if seen.any() else 1.0
    for k in range(_SPIRAL):
        angle, radius = 2.399963 * k, reach * np.sqrt((k + 0.5) / _SPIRAL)
        shift = (round(radius * np.sin(angle)), round(radius * np.cos(angle)))
        towards = np.roll(position, shift, axis=(0, 1)) - position
        square = np.einsum("hwd,hwd->hw", towards, towards)
        rise = np.einsum("hwd,hwd->hw", towards, normal) - np.float32(2e-4 * scale)
        near = square < (0.25 * scale) ** 2
        with_neighbour = near & np.roll(seen, shift, axis=(0, 1))
        hidden += np.where(with_neighbour, np.maximum(rise, 0) / np.sqrt(square + 1e-12), 0)
    hidden = np.where(seen, hidden / _SPIRAL, 0)
    weight = gaussian_filter(seen.astype(np.float32), 2.0) + 1e-6
    smooth = gaussian_filter(hidden, 2.0) / weight
    return np.asarray(np.clip(1 - 1.7 * smooth, 0.15, 1), dtype=np.float32)


def to_srgb(linear: Image32) -> Image32:
    """Linear light in [0, 1] as sRGB in [0, 1]."""
    light = np.clip(linear, 0, 1)
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


def to_linear(srgb: Image32) -> Image32:
    """sRGB in [0, 1] as linear light in [0, 1]."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
