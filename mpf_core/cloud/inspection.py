"""What the reader made of a file, as one object for the command and the service."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mpf_core.cloud.limits import DEFAULT_LIMITS, Limits
from mpf_core.cloud.pointcloud import PointCloud
from mpf_core.cloud.prepare import PreparationReport, PrepareOptions, prepare
from mpf_core.cloud.reader import read
from mpf_core.cloud.reading import Column, describe_columns
from mpf_core.errors import CloudError


@dataclass(frozen=True)
class Inspection:
    """A file as the reader understood it.

    file: its name, without folders
    bytes: its size
    format, dialect: "ply" or "xyz", and the variant in words
    points: rows in the file
    columns: names and what they were taken for
    normals, colors: whether they were read
    low, high: corners of the box of the finite points, input units; None if there are none
    spacing: gap between samples, input units; None if no surface can be made of them
    preparation: what `prepare` makes of the points; None if it refuses them
    notes, warnings: sentences; warnings are for the user to look at
    """

    file: str
    bytes: int
    format: str
    dialect: str
    points: int
    columns: tuple[Column, ...]
    normals: bool
    colors: bool
    low: tuple[float, float, float] | None
    high: tuple[float, float, float] | None
    spacing: float | None
    preparation: PreparationReport | None
    notes: tuple[str, ...]
    warnings: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """The inspection as JSON carries it."""
        return asdict(self)


def inspect_cloud(
    path: str | os.PathLike[str], *, name: str | None = None, limits: Limits = DEFAULT_LIMITS
) -> Inspection:
    """Reads the file and says what it found; `name` stands for the path's where given.

    Raises what `read_cloud` raises. A cloud that reads well but makes no surface is a warning.
    """
    reading = read(path, limits=limits)
    cloud = reading.cloud
    warnings = list(reading.warnings)
    preparation = None
    try:
        preparation = prepare(cloud, PrepareOptions(max_points=limits.max_points)).report
    except CloudError as error:
        warnings.append(f"no surface can be made of this cloud ({error.code}): {error}")
    density = preparation.density if preparation else None
    low, high = _box(cloud)
    return Inspection(
        file=name or Path(path).name,
        bytes=Path(path).stat().st_size,
        format=reading.format,
        dialect=reading.dialect,
        points=len(cloud),
        columns=reading.columns,
        normals=cloud.normals is not None,
        colors=cloud.colors is not None,
        low=low,
        high=high,
        spacing=density.spacing if density else None,
        preparation=preparation,
        notes=tuple(note for note in cloud.notes if note not in reading.warnings),
        warnings=tuple(warnings),
    )


Corner = tuple[float, float, float]


def _box(cloud: PointCloud) -> tuple[Corner | None, Corner | None]:
    finite = cloud.points[np.isfinite(cloud.points).all(axis=1)]
    if len(finite) == 0:
        return None, None
    lx, ly, lz = finite.min(axis=0).tolist()
    hx, hy, hz = finite.max(axis=0).tolist()
    return (lx, ly, lz), (hx, hy, hz)


def lines(found: Inspection) -> list[str]:
    """The inspection for a terminal."""
    shown = [
        ("file", f"{found.file}, {found.bytes:,} bytes"),
        ("format", f"{found.format}, {found.dialect}"),
        ("points", f"{found.points:,}"),
        ("columns", describe_columns(found.columns)),
    ]
    if found.low is not None and found.high is not None:
        sides = zip("xyz", found.low, found.high, strict=True)
        shown.append(("extents", ", ".join(f"{a} {lo:.10g} to {hi:.10g}" for a, lo, hi in sides)))
    if found.spacing is not None:
        shown.append(("spacing", f"{found.spacing:.4g}"))
    if found.preparation is not None:
        shown += [("prepared", step) for step in found.preparation.steps]
    shown += [("note", note) for note in found.notes if not note.startswith("columns: ")]
    shown += [("warning", warning) for warning in found.warnings]
    return [f"{label:<9} {text}" for label, text in shown]
