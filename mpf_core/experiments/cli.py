"""`mpf sample`: clouds for a first try. `mpf experiment`: the paper's tables."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mpf_core.errors import InputError

if TYPE_CHECKING:
    from mpf_core.experiments.trial import Trial

# The names are written out so that `--help` need not load the shapes.
DEFAULT = "potted-plant"


@click.command()
@click.argument("name", required=False, default=DEFAULT)
@click.option(
    "-o", "--output", type=click.Path(path_type=Path, dir_okay=False), help="The PLY to write."
)
@click.option("--list", "only_list", is_flag=True, help="List the samples and stop.")
@click.option("--points", type=click.IntRange(100, 5_000_000), help="How many points.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True)
@click.option(
    "--truth",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Also write the exact surface of a simulated scan, for mpf evaluate (PLY).",
)
def sample(
    name: str,
    output: Path | None,
    only_list: bool,
    points: int | None,
    seed: int,
    truth: Path | None,
) -> None:
    """Write the sample cloud NAME (default: a scanned potted plant) as binary PLY."""
    from mpf_core.experiments.samples import SAMPLES

    if only_list:
        for known in SAMPLES.values():
            click.echo(f"{known.name:<16}{known.points:>8} points  {known.about}")
        return
    if name not in SAMPLES:
        raise click.BadParameter(f"there is no sample {name!r}; see --list", param_hint="NAME")
    if output is None:
        raise click.UsageError("Say where to write the cloud: -o cloud.ply.")
    if truth is not None and SAMPLES[name].truth is None:
        raise click.UsageError(f"{name} is a real measurement: there is no exact surface.")
    try:
        _write(name, output, points, seed, truth)
    except OSError as error:
        raise click.ClickException(f"{error.filename}: {error.strerror}.") from error


def _write(name: str, output: Path, points: int | None, seed: int, truth: Path | None) -> None:
    from mpf_core.experiments.samples import SAMPLES, make_sample
    from mpf_core.files import write_atomically
    from mpf_core.surface.export import cloud_ply_bytes, write_ply

    made = SAMPLES[name]
    cloud = make_sample(name, points, seed)
    comments = [f"mpf sample {name}: {made.about}", f"unit {made.unit}, seed {seed}"]
    write_atomically(output, cloud_ply_bytes(cloud, comments))
    click.echo(f"{output}: {len(cloud)} points, {made.about}", err=True)
    if truth is not None and made.truth is not None:
        write_ply(made.truth(), truth)
        click.echo(f"{truth}: its exact surface", err=True)


EXPERIMENTS = ("thickness", "shapes", "noise", "presets", "extraction")


@click.command()
@click.argument("name", type=click.Choice(EXPERIMENTS))
@click.option(
    "--quick", is_flag=True, help="A small form of at most 20 s; says nothing of quality."
)
@click.option("--budget", type=click.FloatRange(1), help="Seconds for each fit.")
@click.option("--seeds", type=click.IntRange(1, 20), default=1, show_default=True)
@click.option("--preset", help="Options to start from, as for mpf reconstruct.")
@click.option("--only", help="Only trials whose label holds this text.")
@click.option(
    "--meshes",
    type=click.Path(path_type=Path, file_okay=False, exists=True),
    help="Folder with the bodies that presets names.",
)
@click.option(
    "--clouds",
    type=click.Path(path_type=Path, file_okay=False, exists=True),
    help="Folder with the scans that presets names.",
)
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), help="Where all goes.")
@click.option("--json", "as_json", is_flag=True, help="Print the rows as JSON.")
def experiment(
    name: str,
    quick: bool,
    budget: float | None,
    seeds: int,
    preset: str | None,
    only: str | None,
    meshes: Path | None,
    clouds: Path | None,
    out: Path | None,
    as_json: bool,
) -> None:
    """Run one of the paper's experiments: a table, the meshes and their pictures.

    Rows that are there already are kept, so a stopped experiment goes on where it was.
    """
    from mpf_core.experiments import suite, tables, trial
    from mpf_core.files import write_atomically
    from mpf_core.surface.drawing import png_bytes

    directory = out or Path("out") / "experiments" / (f"{name}-quick" if quick else name)
    if name == "extraction":
        _extraction(directory, quick, budget, as_json)
        return
    wanted = suite.trials(
        name, quick=quick, seeds=seeds, preset=preset, budget=budget, meshes=meshes, clouds=clouds
    )
    wanted = [t for t in wanted if only is None or only in t.label]
    _check_options(wanted)
    rows = []
    samples = 10_000 if quick else 100_000
    for row in trial.run(wanted, directory, trial.METHODS, samples=samples):
        rows.append(row)
        click.echo(_progress(row, len(rows), len(wanted)), err=True)
    about = suite.EXPERIMENTS[name]
    asked: dict[str, Any] = {
        "--budget": budget,
        "--seeds": seeds,
        "--preset": preset,
        "--only": only,
    }
    asked |= {"--meshes": meshes and "DIR", "--clouds": clouds and "DIR"}
    given = [f"{flag}={value}" for flag, value in asked.items() if value is not None]
    quickly = ["--quick"] if quick else []
    command = shlex.join(["mpf", "experiment", name, *quickly, *given])
    table = tables.markdown(about.title, rows, about.paper, command, about.beside)
    write_atomically(directory / "table.md", table.encode())
    write_atomically(directory / "rows.json", json.dumps(rows, indent=2).encode())
    sheet = tables.contact_sheet(rows, directory)
    if sheet is not None:
        write_atomically(directory / "sheet.png", png_bytes(sheet))
    click.echo(json.dumps(rows, indent=2) if as_json else table)
    if any("error" in row for row in rows):
        raise SystemExit(3)


def _extraction(directory: Path, quick: bool, budget: float | None, as_json: bool) -> None:
    from mpf_core.experiments import extraction
    from mpf_core.files import write_atomically

    rows = extraction.measured(directory, quick=quick, budget=budget)
    command = "mpf experiment extraction" + (" --quick" if quick else "")
    table = extraction.markdown(rows, command)
    write_atomically(directory / "table.md", table.encode())
    write_atomically(directory / "rows.json", json.dumps(rows, indent=2).encode())
    click.echo(json.dumps(rows, indent=2) if as_json else table)


def _check_options(trials: list[Trial]) -> None:
    """Refuse wrong options before the first fit, not in every row."""
    from mpf_core.options import options_from

    if not trials:
        raise click.UsageError("no trial has that in its label")
    try:
        options_from(dict(trials[0].options))
    except InputError as error:
        raise click.UsageError(str(error)) from error


def _progress(row: dict[str, Any], done: int, all_of_them: int) -> str:
    metrics = row.get("metrics", {})
    name = "chamfer" if "chamfer" in metrics else "input_to_surface"
    found = row.get("error") or f"{name.replace('_', ' ')} × 10³ {metrics[name]:.3g}"
    label, seed = row["trial"]["label"], row["trial"]["seed"]
    return f"[{done}/{all_of_them}] {label}, seed {seed}: {found}, {row['seconds']:.0f} s"
