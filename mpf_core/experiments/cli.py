"""`mpf sample`: clouds for a first try."""

from __future__ import annotations

from pathlib import Path

import click

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
