"""Rows of experiments as a table, and their meshes as one sheet of pictures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from mpf_core.experiments.shapes import whole
from mpf_core.experiments.trial import Row, mesh_path
from mpf_core.quality.meshio import read_mesh
from mpf_core.quality.metrics import point_distances
from mpf_core.quality.raster import Camera
from mpf_core.quality.render import Scale, render, side_by_side

# The greatest distance that the error colours tell apart, × 10³ in the normalised frame.
ERROR_LIMIT = 10.0


@dataclass(frozen=True)
class Column:
    """A figure of the rows: its heading, its name among the metrics, factor and digits."""

    heading: str
    metric: str
    factor: float = 1.0
    digits: int = 2


COLUMNS = (
    Column("Chamfer × 10³", "chamfer"),
    Column("before the last step", "alone_chamfer"),
    Column("input to surface × 10³", "input_to_surface"),
    Column("F 0.005, %", "f_score_005", 100, 1),
    Column("F 0.01, %", "f_score_010", 100, 1),
    Column("normals", "normal_consistency", 1, 3),
    Column("Hausdorff × 10³", "hausdorff", 1000, 1),
    Column("pieces", "components", 1, 0),
    Column("boundary edges", "boundary_edges", 1, 0),
    Column("non-manifold", "nonmanifold_edges", 1, 0),
    Column("crossings", "self_intersections", 1, 0),
    Column("Euler", "euler_characteristic", 1, 0),
    Column("slivers", "slivers", 1, 0),
    Column("double cover × 10³", "double_thickness", 1000, 1),
    Column("farthest piece, spacings", "farthest_component"),
    Column("iterations", "iterations", 1, 0),
    Column("cells", "resolution", 1, 0),
    Column("processor s", "processor_seconds", 1, 0),
    Column("peak MiB", "peak_mib", 1, 0),
)


def markdown(
    title: str, rows: Sequence[Row], cited: dict[str, str], command: str, beside: str = "paper"
) -> str:
    """A table with one line per label and method: means over the seeds, and half their spread.

    cited: what others published for a label, or what is to be reached, shown under the heading
    `beside`; command: what made the rows
    """
    known = {name for row in rows for name in row.get("metrics", {})}
    columns = [c for c in COLUMNS if c.metric in known] or list(COLUMNS)
    headings = ["", "method", *(c.heading for c in columns), "s", *([beside] if cited else [])]
    lines = [f"## {title}", "", _line(headings), _line(["---"] * len(headings))]
    for (label, method), group in _grouped(rows).items():
        cells = [label, method, *(_cell(group, c) for c in columns)]
        cells.append(_spread([r["seconds"] for r in group], 0))
        lines.append(_line([*cells, *([cited.get(label, "–")] if cited else [])]))
    failed = [f"- {r['trial']['label']}: {r['error']}" for r in rows if "error" in r]
    notes = _notes(rows, command)
    return "\n".join([*lines, "", *failed, *([""] if failed else []), *notes, ""])


def plain(rows: Sequence[Row], command: str) -> str:
    """Rows of any figures: a column for each name, empty where a row has none."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    lines = [_line(names), "| --- |" + " ---: |" * (len(names) - 1)]
    lines += [_line([_text(row.get(name)) for name in names]) for row in rows]
    return f"`{command}`\n\n" + "\n".join(lines) + "\n"


def course_markdown(rows: Sequence[Row]) -> str:
    """Where each fit stood on its way, and how long the first of each shape took to get where the
    others ended; empty where no fit was watched."""
    watched = [row for row in rows if "course" in row and "metrics" in row]
    if not watched:
        return ""
    lines = ["", _line(["on the way", "iterations", "s", "Chamfer × 10³", "pieces"])]
    lines.append(_line(["---"] * 5))
    for row in watched:
        for m in row["course"]:
            found = [_text(m.get("chamfer")) or "no surface", _text(m.get("components"))]
            cells = [row["trial"]["label"], str(m["iteration"]), f"{m['seconds']:.0f}", *found]
            lines.append(_line(cells))
    return "\n".join([*lines, "", *_equals(watched), ""])


def _equals(watched: Sequence[Row]) -> list[str]:
    """Each fit against the first one of its shape, which is the paper's."""
    told = []
    first: dict[str, Row] = {}
    for row in watched:
        paper = first.setdefault(row["trial"]["shape"], row)
        if paper is row:
            continue
        ours, seconds = row["metrics"]["chamfer"], row["seconds"]
        known = [m for m in paper["course"] if "chamfer" in m]
        as_good = next((m["seconds"] for m in known if m["chamfer"] <= ours), None)
        equal = next((m["chamfer"] for m in reversed(known) if m["seconds"] <= seconds), None)
        names = row["trial"]["label"], paper["trial"]["label"]
        reached = f"after {as_good / seconds:.1f} times as long" if as_good else "never"
        told.append(
            f"- {names[0]}: {ours:.2f} after {seconds:.0f} s. {names[1]}: "
            f"{_text(equal) or 'no surface'} by then, as good {reached}"
            f" ({known[-1]['chamfer']:.2f} at its end, {known[-1]['seconds']:.0f} s)."
            if known
            else f"- {names[1]} had no surface."
        )
    return told


def course_sheet(rows: Sequence[Row], directory: Path) -> Image.Image | None:
    """A band of pictures for each watched fit: its surface on the way, in error colours."""
    bands = []
    for row in rows:
        there = [m for m in row.get("course", ()) if "chamfer" in m]
        if not there:
            continue
        pictures = [error_picture(row, directory, iteration=m["iteration"]) for m in there]
        label = row["trial"]["label"]
        captions = [f"{label}, {m['iteration']}: {m['chamfer']:.2f}" for m in there]
        bands.append(side_by_side(pictures, captions))
    return stacked(bands) if bands else None


def contact_sheet(rows: Sequence[Row], directory: Path, across: int = 4) -> Image.Image | None:
    """One picture per label and method, all in error colours under the same light."""
    pictures, captions = [], []
    for (label, method), group in _grouped(rows).items():
        row = next((r for r in group if "metrics" in r), None)
        if row is None:
            continue
        if "chamfer" not in row["metrics"]:
            continue
        pictures.append(error_picture(row, directory))
        captions.append(f"{label}, {method}: {row['metrics']['chamfer']:.2f}")
    if not pictures:
        return None
    rows_of = range(0, len(pictures), across)
    bands = [side_by_side(pictures[k : k + across], captions[k : k + across]) for k in rows_of]
    return stacked(bands)


def stacked(bands: Sequence[Image.Image]) -> Image.Image:
    """Pictures below each other on white."""
    width, height = max(b.width for b in bands), sum(b.height for b in bands)
    sheet = Image.new("RGB", (width, height), "white")
    top = 0
    for band in bands:
        sheet.paste(band, (0, top))
        top += band.height
    return sheet


def error_picture(
    row: Row,
    directory: Path,
    size: tuple[int, int] = (520, 420),
    iteration: int | None = None,
) -> Image.Image:
    """The mesh of a row or of a moment of it, seen as its reference is, coloured by its distance
    to it."""
    reference = whole(row["trial"]["shape"], row["trial"]["thickness"])
    mesh = read_mesh(mesh_path(directory, row, iteration))
    errors = 1e3 * point_distances(mesh.vertices, reference)
    scale = Scale(errors, (0.0, ERROR_LIMIT), "distance × 10³")
    return render(mesh, camera=Camera.around(reference.vertices, size=size), scale=scale)


def _grouped(rows: Sequence[Row]) -> dict[tuple[str, str], list[Row]]:
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row["trial"]["label"], row["trial"]["method"]), []).append(row)
    return groups


def _cell(group: Sequence[Row], column: Column) -> str:
    name = column.metric
    found = [r["metrics"][name] for r in group if name in r.get("metrics", {})]
    values = [value * column.factor for value in found if value is not None]
    return _spread(values, column.digits)


def _spread(values: Sequence[float], digits: int) -> str:
    if not values:
        return "–"
    middle, half = float(np.mean(values)), (max(values) - min(values)) / 2
    shown = f"{middle:.{digits}f}"
    return (
        f"{shown} ± {half:.{digits}f}" if len(values) > 1 and not math.isclose(half, 0) else shown
    )


def _notes(rows: Sequence[Row], command: str) -> list[str]:
    measured = [r for r in rows if "metrics" in r]
    if not measured:
        return [f"`{command}`"]
    samples = next((m["samples"] for r in measured if "samples" in (m := r["metrics"])), "no")
    where = ", ".join(f"{name} {value}" for name, value in measured[0]["machine"].items())
    seeds = len({r["trial"]["seed"] for r in rows})
    return [
        f"Point-to-triangle, both ways, halved; {samples} samples on each mesh; floor 0; longest "
        f"side of the reference 2. {seeds} seed{'s' if seeds > 1 else ''}: mean ± half the range.",
        "",
        f"`{command}` on {where}.",
    ]


def _text(value: Any) -> str:
    if isinstance(value, list):
        return ", ".join(_text(one) for one in value) or "–"
    if isinstance(value, float):
        return f"{value:.3g}" if abs(value) < 100 else f"{value:.0f}"
    return "" if value is None else str(value)


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"
