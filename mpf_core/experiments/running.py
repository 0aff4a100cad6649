"""An experiment from what is asked to its table, rows and pictures in a folder."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

from mpf_core.errors import OptionsError
from mpf_core.experiments import (
    baselines,
    cost,
    course,
    extraction,
    fields,
    plots,
    scaling,
    suite,
    tables,
    tiling,
    trial,
)
from mpf_core.experiments.asked import Asked
from mpf_core.experiments.trial import Method, Row, Trial
from mpf_core.files import write_atomically
from mpf_core.options import options_from
from mpf_core.surface.drawing import png_bytes

Tell = Callable[[str], None]

# Tables of their own form, which are not made of trials.
MEASUREMENTS: dict[str, Callable[[Path, Asked], list[Row]]] = {
    "extraction": extraction.measured,
    "cost": cost.measured,
    "fields": fields.measured,
    "tiles": tiling.measured,
}


def run(name: str, asked: Asked, directory: Path, tell: Tell) -> tuple[list[Row], str]:
    """The rows and the table of an experiment, written to `directory` with the pictures.

    Raises OptionsError before the first fit for what cannot be run.
    """
    directory.mkdir(parents=True, exist_ok=True)
    if name in MEASUREMENTS:
        rows = MEASUREMENTS[name](directory, asked)
        table = tables.plain(rows, asked.command(name))
    else:
        rows = _trials(suite.trials(name, asked), asked, directory, tell)
        about = suite.EXPERIMENTS[name]
        table = tables.markdown(about.title, rows, about.paper, asked.command(name), about.beside)
        table += tables.course_markdown(rows)
        _pictures(rows, directory)
    write_atomically(directory / "table.md", table.encode())
    write_atomically(directory / "rows.json", json.dumps(rows, indent=2).encode())
    return rows, table


def methods(directory: Path) -> Mapping[str, Method]:
    """Every way to a mesh, by the name that trials give it."""
    watched = partial(course.course, folder=directory / "states")
    others: dict[str, Method] = {"course": watched, "process": scaling.process}
    return trial.METHODS | baselines.BASELINES | others


def _trials(wanted: list[Trial], asked: Asked, directory: Path, tell: Tell) -> list[Row]:
    if not wanted:
        raise OptionsError("no trial has that in its label", advice="Leave out --only.")
    for one in wanted:
        if one.is_fit:
            options_from(dict(one.options))
    if any(one.method in baselines.BASELINES for one in wanted):
        baselines.required()
    samples = 10_000 if asked.quick else 100_000
    rows = []
    for row in trial.run(wanted, directory, methods(directory), samples=samples):
        rows.append(row)
        tell(f"[{len(rows)}/{len(wanted)}] {_told(row)}")
    return rows


def _pictures(rows: list[Row], directory: Path) -> None:
    for name, sheet in (
        ("sheet.png", tables.contact_sheet(rows, directory)),
        ("course.png", tables.course_sheet(rows, directory)),
    ):
        if sheet is not None:
            write_atomically(directory / name, png_bytes(sheet))
    curves = plots.chamfer_over_time(rows)
    if curves is not None:
        write_atomically(directory / "chamfer-over-time.png", curves)


def _told(row: Row) -> str:
    metrics = row.get("metrics", {})
    name = "chamfer" if "chamfer" in metrics else "input_to_surface"
    found = row.get("error") or f"{name.replace('_', ' ')} × 10³ {metrics[name]:.3g}"
    asked = row["trial"]
    who = (
        asked["label"] if asked["method"] in trial.FITS else f"{asked['label']}, {asked['method']}"
    )
    return f"{who}, seed {asked['seed']}: {found}, {row['seconds']:.0f} s"
