"""What the columns of a text cloud are, where no header says so: decided by place and values.

The rule: x, y, z come first. Of what follows, three columns of unit length are normals; three of
whole numbers 0..255, or of fractions 0..1, are colours; a single column is an intensity.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mpf_core.cloud.columns import COLORS, COORDINATES, NORMALS

_UNIT_TOLERANCE = 0.02  # normals written with two digits still pass
_SHARE = 0.99  # of the rows must be unit vectors; scanners leave some out


@dataclass(frozen=True)
class Roles:
    """Role → column index, with what is sure in `notes` and what is a guess in `warnings`."""

    index: dict[str, int]
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = field(default=())


def guess_roles(extras: NDArray[np.float64], columns: int) -> Roles:
    """Roles of all columns from the values (n, k) of those after the coordinates."""
    index = dict(zip(COORDINATES, range(3), strict=True))
    warnings: list[str] = []
    k = extras.shape[1]
    starts = range(k - 2)
    units = [s for s in starts if are_unit_vectors(extras[:, s : s + 3])]
    normal = min(units, key=lambda s: _length_error(extras[:, s : s + 3]), default=None)
    if normal is not None:
        index.update({role: 3 + normal + i for i, role in enumerate(NORMALS)})
    taken = set() if normal is None else {normal, normal + 1, normal + 2}
    free = [s for s in starts if not taken & {s, s + 1, s + 2}]
    color = _color_start(extras, free, warnings)
    if color is not None:
        index.update({role: 3 + color + i for i, role in enumerate(COLORS)})
        taken |= {color, color + 1, color + 2}
    rest = [s for s in range(k) if s not in taken]
    if rest == [0] or (rest and rest[0] == 0 and color == 1):
        index["intensity"] = 3
        rest = rest[1:]
    if rest or columns > 3 + k:
        listed = ", ".join(str(4 + s) for s in rest)
        listed += " and those after" * (columns > 3 + k)
        warnings.append(f"columns {listed} fit no rule and are left out; a header would name them")
    return Roles(index, warnings=tuple(warnings))


def counts_up(column: NDArray[np.float64]) -> bool:
    """Whether each of three rows or more is one above the last, from 0 or 1: a point's number."""
    if len(column) < 3 or column[0] not in (0, 1):
        return False
    return bool((column == np.arange(len(column)) + column[0]).all())


def are_unit_vectors(vectors: NDArray[np.float64]) -> bool:
    """Whether nearly all rows (n, 3) have length 1, and the others none."""
    if len(vectors) == 0 or not (np.abs(vectors[:1000]) <= 1 + _UNIT_TOLERANCE).all(axis=1).any():
        return False
    with np.errstate(over="ignore", invalid="ignore"):
        square = np.einsum("nk,nk->n", vectors, vectors)
        unit = np.abs(np.sqrt(square) - 1) < _UNIT_TOLERANCE
    missing = ~np.isfinite(square) | (square == 0)
    return bool(unit.mean() >= _SHARE or (unit.any() and (unit | missing).mean() >= _SHARE))


def _length_error(vectors: NDArray[np.float64]) -> float:
    """Median distance of the lengths of rows (n, 3) from 1."""
    with np.errstate(over="ignore", invalid="ignore"):
        return float(np.nanmedian(np.abs(np.linalg.norm(vectors, axis=1) - 1)))


def _color_start(extras: NDArray[np.float64], starts: list[int], warnings: list[str]) -> int | None:
    """The first of three colour columns among `starts`, or None."""
    found = [s for s in starts if _is_whole_color(extras[:, s : s + 3])]
    if not found:
        fractions = [s for s in starts if _is_fraction_color(extras[:, s : s + 3])]
        if fractions:
            s = fractions[0]
            warnings.append(
                f"columns {4 + s} to {6 + s} lie in 0..1 and are taken for colours; "
                "a header would make this sure"
            )
            return s
        return None
    if 0 in found and 1 in found:
        if bool((extras[:, 3] == 255).all()):  # an alpha that says nothing
            return 0
        warnings.append(
            "columns 4 to 7 all look like colours; read as intensity, red, green, blue, "
            "the order of PTS"
        )
        return 1
    return found[0]


def _is_whole_color(values: NDArray[np.float64]) -> bool:
    """Whole numbers 0..255, some of them above 1."""
    for channel in values.T:
        if not (channel.min(initial=0) >= 0 and channel.max(initial=0) <= 255):
            return False
        if not np.array_equal(channel, np.rint(channel)):
            return False
    return len(values) > 0 and float(values.max()) > 1


def _is_fraction_color(values: NDArray[np.float64]) -> bool:
    """Numbers 0..1 that are not all whole."""
    if len(values) == 0 or not (values.min() >= 0 and values.max() <= 1):
        return False
    return bool((values != np.rint(values)).any())
