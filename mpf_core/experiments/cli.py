"""`mpf sample`: clouds for a first try. `mpf experiment`: the paper's tables."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Any

import click

from mpf_core.errors import InputError
from mpf_core.experiments.asked import Asked

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


EXPERIMENTS = (
    "thickness", "shapes", "noise", "presets", "ablation", "beta", "phase-only", "fields",
    "scaling", "baselines", "paper", "extraction", "cost", "tiles",
)  # fmt: skip


@click.command()
@click.argument("name", type=click.Choice(EXPERIMENTS))
@click.option(
    "--quick", is_flag=True, help="A small form of at most 20 s; says nothing of quality."
)
@click.option("--budget", type=click.FloatRange(1), help="Seconds for each fit.")
@click.option("--seeds", type=click.IntRange(1, 20), default=1, show_default=True)
@click.option("--preset", help="Options to start from, as for mpf reconstruct.")
@click.option("--iterations", type=click.IntRange(1), help="Of each fit, whatever they take.")
@click.option("--points", type=click.IntRange(16), help="In each set of points of a step.")
@click.option("--resolution", type=click.IntRange(16, 2048), help="Cells of each extraction.")
@click.option("--only", help="Only trials whose label holds this text.")
@click.option(
    "--meshes",
    type=click.Path(path_type=Path, file_okay=False, exists=True),
    help="Folder with bodies: those that presets names, or your own for shapes.",
)
@click.option(
    "--clouds",
    type=click.Path(path_type=Path, file_okay=False, exists=True),
    help="Folder with scans: those that presets names, or your own for shapes.",
)
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), help="Where all goes.")
@click.option("--json", "as_json", is_flag=True, help="Print the rows as JSON.")
def experiment(name: str, out: Path | None, as_json: bool, **flags: Any) -> None:
    """Run one of the paper's experiments: a table, the meshes and their pictures.

    Rows that are there already are kept, so a stopped experiment goes on where it was.
    """
    from mpf_core.experiments import running

    asked = Asked(**flags)
    folder = f"{name}-quick" if asked.quick else name
    directory = out or Path("out") / "experiments" / folder
    try:
        rows, table = running.run(name, asked, directory, partial(click.echo, err=True))
    except InputError as error:
        raise click.UsageError(str(error)) from error
    click.echo(json.dumps(rows, indent=2) if as_json else table)
    if any("error" in row for row in rows):
        raise SystemExit(3)
