"""Colours and normals from the many scales in which tools write them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

_HARMONIC = 0.28209479177387814  # the constant spherical harmonic, 1 / (2 √π)
_UNIT_TOLERANCE = 1e-5  # single-precision unit vectors are left as they are


def unit_normals(vectors: NDArray[Any]) -> tuple[NDArray[np.float64] | None, list[str]]:
    """Unit normals of any vectors (n, 3), with what had to be done in words.

    Rows without a direction (zero, NaN, infinite) become zero; None if all are.
    """
    normals = np.array(vectors, dtype=np.float64)
    with np.errstate(over="ignore", invalid="ignore"):
        # The largest component first: the square of 1e200 is not a number that can be held.
        largest = np.abs(normals).max(axis=1, initial=0.0)
        good = np.isfinite(largest) & (largest > 0)
        normals[~good] = 0.0
        extreme = good & ((largest > 1e100) | (largest < 1e-100))
        normals[extreme] /= largest[extreme, None]
        length = np.sqrt(np.einsum("nk,nk->n", normals, normals))
    if len(normals) and not good.any():
        return None, ["normals are all zero and left out"]
    notes = []
    off = good & (np.abs(length - 1) > _UNIT_TOLERANCE)
    if off.any():
        normals[off] /= length[off, None]
        notes.append(f"{int(off.sum())} normals scaled to unit length")
    if not good.all():
        notes.append(f"{int((~good).sum())} normals have no direction and are set to zero")
    return normals, notes


def colors_to_uint8(
    values: NDArray[Any], *, whole: bool, sixteen: bool = False
) -> tuple[NDArray[np.uint8] | None, str, bool]:
    """8-bit colours of `values` (n, 3), the scale found in words, and whether that is a guess.

    whole: the file declares integers; sixteen: of 16 bits. Integers are 0..255, or 0..65535 where
    any is above 255; other numbers are 0..1, or 0..255 where any is above 1. None if they fit no
    scale.
    """
    if len(values) == 0:
        return np.zeros((0, 3), dtype=np.uint8), "0..255", False
    if values.dtype == np.uint8:
        return np.ascontiguousarray(values), "0..255", False
    low, high = float(values.min()), float(values.max())  # NaN anywhere fails both comparisons
    if not (low >= 0 and high <= 65535):
        return None, f"from {low:g} to {high:g}", True
    if whole:
        if high <= 255:
            # Tools that declare 16 bits and write 8 are as common as clouds that dark are rare.
            return values.astype(np.uint8), "0..255", sixteen
        return _round(values, 255 / 65535), "0..65535", False
    if high <= 1:
        return _round(values, 255.0), "0..1", False
    if high <= 255:
        return _round(values, 1.0), "0..255", True
    return None, f"from {low:g} to {high:g}", True


def splat_colors(coefficients: NDArray[Any]) -> NDArray[np.uint8] | None:
    """Base colours of Gaussian splats from their constant harmonics (n, 3); None if not finite."""
    if not np.isfinite(coefficients).all():
        return None
    return _round(np.clip(0.5 + _HARMONIC * coefficients.astype(np.float64), 0, 1), 255.0)


def _round(values: NDArray[Any], factor: float) -> NDArray[np.uint8]:
    out = np.empty(values.shape, dtype=np.uint8)
    for channel in range(values.shape[1]):  # by channel, so that no copy of all is ever held
        out[:, channel] = np.rint(values[:, channel].astype(np.float64) * factor)
    return out
