"""Rows of experiments as a table, and their meshes as one sheet of pictures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from mpf_core.experiments.shapes import shape
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
    Column("farthest piece, spacings", "farthest_component"),
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
    width, height = max(b.width for b in bands), sum(b.height for b in bands)
    sheet = Image.new("RGB", (width, height), "white")
    top = 0
    for band in bands:
        sheet.paste(band, (0, top))
        top += band.height
    return sheet


def error_picture(row: Row, directory: Path, size: tuple[int, int] = (520, 420)) -> Image.Image:
    """The mesh of a row, seen as its reference is, coloured by its distance to it."""
    reference = shape(row["trial"]["shape"])
    mesh = read_mesh(mesh_path(directory, row))
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
    values = [r["metrics"][name] * column.factor for r in group if name in r.get("metrics", {})]
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


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"
