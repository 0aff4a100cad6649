"""Slices of a field as pictures: where to cut, where to evaluate, which files to write."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from mpf_core.files import write_atomically
from mpf_core.parallel import shared
from mpf_core.surface.sliceimage import (
    ACROSS,
    SINGLE,
    STACK,
    Box,
    Extent,
    Format,
    plot_box,
    slice_image,
)

AXES = ("x", "y", "z")
COARSE = 4  # samples between two that are evaluated whatever their values
LIMIT = 0.5  # normalised |value| of the strongest colours
Evaluate = Callable[[NDArray[np.float64]], NDArray[np.floating]]


class Frame(Protocol):
    """What is used of `mpf_core.cloud.normalize.Similarity`."""

    @property
    def scale(self) -> float: ...
    def to_input(self, points: NDArray[np.floating]) -> NDArray[np.float64]: ...


@dataclass(frozen=True)
class Cut:
    """A picture of the field on the plane `axis` = `at`, and what lays it where it was taken.

    extent: of the plot: left, right, bottom, top; it and `at` are in the input's units
    plot: where the plot lies in the picture: left, top, width, height in pixels
    """

    picture: bytes
    axis: str
    at: float
    extent: Extent
    plot: Box

    def told(self, file: str, field: str) -> dict[str, Any]:
        """What the report says of it, written as `file`."""
        return {
            "file": file,
            "field": field,
            "axis": self.axis,
            "at": self.at,
            "extent": list(self.extent),
            "plot": list(self.plot),
        }


@dataclass(frozen=True)
class Slice:
    """One written picture."""

    index: int
    path: Path
    cut: Cut


def write_slices(
    evaluate: Evaluate,
    similarity: Frame,
    box: NDArray[np.float64],
    count_per_axis: int,
    directory: str | Path,
    *,
    field: str = "phi",
    format: Format = STACK,
    unit_label: str = "",
) -> list[Slice]:
    """Write `slices/{axis}/{index}.png` under `directory`, evenly spaced over `box`.

    evaluate: field values (n,) at normalised points (n, 3); box: (2, 3) normalised corners.
    Lengths shown are in the input's units.
    """
    planes = [
        (axis, index, at)
        for axis in AXES
        for index, at in enumerate(evenly(box, axis, count_per_axis))
    ]

    def drawn(part: slice) -> list[Slice]:
        written = []
        for axis, index, at in planes[part]:
            path = Path(directory) / "slices" / axis / f"{index}.png"
            path.parent.mkdir(parents=True, exist_ok=True)
            made = cut(
                evaluate, similarity, box, axis, at,
                field=field, format=format, unit_label=unit_label,
            )  # fmt: skip
            write_atomically(path, made.picture)
            written.append(Slice(index, path, replace(made, picture=b"")))
        return written

    return [one for some in shared(drawn, len(planes)) for one in some]


def evenly(box: NDArray[np.float64], axis: str, count: int) -> list[float]:
    """Normalised positions in the middle of `count` equal layers of the box."""
    low, high = box[:, AXES.index(axis)]
    return [float(low + (index + 0.5) / count * (high - low)) for index in range(count)]


def cut(
    evaluate: Evaluate,
    similarity: Frame,
    box: NDArray[np.float64],
    axis: str,
    at: float,
    *,
    field: str = "phi",
    format: Format = SINGLE,
    unit_label: str = "",
) -> Cut:
    """The field across `axis` at `at` (normalised) as PNG."""
    place = AXES.index(axis)
    right, up = (AXES.index(name) for name in ACROSS[axis])
    sides = box[1] - box[0]
    step = max(sides[right], sides[up]) / (format.samples - 1)
    columns, rows = (COARSE * max(1, round(sides[k] / step / COARSE)) + 1 for k in (right, up))
    points = np.empty((rows, columns, 3))
    points[..., place] = at
    points[..., right] = np.linspace(box[0, right], box[1, right], columns)
    points[..., up] = np.linspace(box[0, up], box[1, up], rows)[:, None]
    # Far from the zero level a field is smooth; P is where it is saturated.
    below = [0.98, 0.98] if field == "P" else [8 * step, 4 * step]
    values = _refined(evaluate, points, below)
    corners = similarity.to_input(points[[0, -1], [0, -1]])
    # Fields but P are lengths; the frame's scale turns them into the input's units.
    length = 1.0 if field == "P" else 1.0 / similarity.scale
    (left, end), (bottom, top) = corners[:, right].tolist(), corners[:, up].tolist()
    extent = (left, end, bottom, top)
    picture = slice_image(
        values * length,
        extent,
        axis=axis,
        at=float(corners[0, place]),
        field=field,
        unit_label=unit_label,
        limit=1.0 if field == "P" else LIMIT * length,
        format=format,
    )
    return Cut(picture, axis, float(corners[0, place]), extent, plot_box(extent, format))


def _refined(
    evaluate: Evaluate, points: NDArray[np.float64], below: Sequence[float]
) -> NDArray[np.float64]:
    """(h, w) field at `points` (h, w, 3), h and w multiples of 2ᵏ plus one for k bounds `below`.

    Every 2ᵏth point in both directions is evaluated; then, halving k times, those in between where
    |value| may be less than the next bound. The others are the mean of their neighbours.
    """
    height, width = points.shape[:2]
    known = np.zeros((height, width), dtype=bool)
    values = np.zeros((height, width))
    size = 2 ** len(below)
    coarse = np.s_[::size, ::size]
    values[coarse] = evaluate(points[coarse].reshape(-1, 3)).reshape(values[coarse].shape)
    known[coarse] = True
    for bound in below:
        half = size // 2
        level, fresh = values[::half, ::half], ~known[::half, ::half]
        between = level.copy()
        between[1::2, ::2] = (level[:-1:2, ::2] + level[2::2, ::2]) / 2
        between[:, 1::2] = (between[:, :-1:2] + between[:, 2::2]) / 2
        near = fresh & (np.abs(between) < bound)
        if near.any():
            between[near] = evaluate(points[::half, ::half][near])
        values[::half, ::half] = between
        known[::half, ::half] |= near
        size = half
    return values
