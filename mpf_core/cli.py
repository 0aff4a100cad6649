"""The `mpf` command: assembled from the entry points of group `mpf.commands`, and `reconstruct`."""

from __future__ import annotations

import time
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

import click

from mpf_core.options import PRESET_NAMES, options_from
from mpf_core.terminal import ProgressLine, changes_in, check_output, told_errors


class _Commands(click.Group):
    """Loads a command's module only when it is called, so that `mpf api` never loads torch."""

    def __init__(self, **settings: Any):
        super().__init__(**settings)
        self.found: dict[str, EntryPoint] = {
            point.name: point for point in entry_points(group="mpf.commands")
        }

    def list_commands(self, ctx: click.Context) -> list[str]:
        del ctx
        return sorted(self.found)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        del ctx
        point = self.found.get(cmd_name)
        command: click.Command | None = None if point is None else point.load()
        return command


@click.group(cls=_Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="metric-phase-fields")
def main() -> None:
    """Surfaces from raw, unoriented point clouds, by Metric-Phase Fields."""


@click.command()
@click.argument("input", type=click.Path(path_type=Path))
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path, dir_okay=False),
              help="Mesh to write: .glb or .ply.")  # fmt: skip
@click.option("--preset", type=click.Choice(PRESET_NAMES), default="balanced", show_default=True)
@click.option("--max-iterations", type=int, help="Cap on optimiser steps.")
@click.option("--time-budget", type=float, help="Cap on the whole run, in seconds.")
@click.option("--resolution", type=int, help="Grid cells along the longest side.")
@click.option("--surface", "surface_kind", type=click.Choice(("shell", "sheet")),
              help="Closed everywhere, or one layer on open sheets.")  # fmt: skip
@click.option("--max-faces", type=int, help="Reduce the mesh to about so many faces.")
@click.option("--seed", type=int, help="Seed of every random draw.")
@click.option("--threads", type=int, help="CPU threads.")
@click.option("--set", "settings", multiple=True, metavar="NAME=VALUE",
              help="Any other option by its name, e.g. --set omega=30.")  # fmt: skip
@click.option("--field", type=click.Path(path_type=Path, dir_okay=False),
              help="File for the fitted field, for `mpf extract` and `mpf slice`.")  # fmt: skip
@click.option("--checkpoint", type=click.Path(path_type=Path, dir_okay=False),
              help="File for the state of the fit: the same command goes on from it.")  # fmt: skip
@click.option("--slices", type=click.Path(path_type=Path, file_okay=False),
              help="Folder for φ-slice pictures.")  # fmt: skip
@click.option("--report", type=click.Path(path_type=Path, dir_okay=False),
              help="JSON file for the report.")  # fmt: skip
def reconstruct(
    input: Path,
    output: Path,
    field: Path | None,
    checkpoint: Path | None,
    slices: Path | None,
    report: Path | None,
    **flags: Any,
) -> None:
    """Reconstruct the surface of the point cloud INPUT (.ply, .xyz)."""
    with told_errors(input):
        _reconstruct(input, output, field, checkpoint, slices, report, flags)


def _reconstruct(
    input: Path,
    output: Path,
    field: Path | None,
    checkpoint: Path | None,
    slices: Path | None,
    report: Path | None,
    flags: dict[str, Any],
) -> None:
    check_output(output, ".glb", ".ply")
    if field is not None:
        check_output(field, option="--field")
    if checkpoint is not None:
        check_output(checkpoint, option="--checkpoint")
    options = options_from(changes_in(flags))
    clock_start = time.monotonic()
    from mpf_core import outputs, results  # load torch
    from mpf_core.field.blendfile import save_field
    from mpf_core.surface.export import write_mesh
    from mpf_core.tiles import forget_kept
    from mpf_core.watch import Watch

    line = ProgressLine()
    watch = Watch(time.monotonic, line.show, None, begin=clock_start, checkpoint=checkpoint)
    result = results.reconstructed(input, options, watch)
    write_mesh(result.mesh, output)
    if field is not None:
        save_field(result.fitted, field)
    line.end()
    seconds = time.monotonic() - clock_start
    told = dict(result.report)
    if slices is not None:
        slices.mkdir(parents=True, exist_ok=True)
        told["slices"] = outputs.write_stack(
            result.fitted, options.surface.slices, slices, options.threads
        )
    if report is not None:
        outputs.write_report(told, report)
    if checkpoint is not None:
        forget_kept(checkpoint)
    click.echo(summary(result.report, output, seconds))


def summary(report: dict[str, Any], output: Path, seconds: float) -> str:
    """The result in words."""
    surface, fit = report["surface"], report["fit"]
    shut = "watertight" if surface["watertight"] else f"{surface['boundary_edges']} boundary edges"
    pieces = surface["components"]
    return (
        f"{output}: {surface['faces']} faces, {shut}, {pieces} component{'s'[: pieces != 1]}, "
        f"input to surface {surface['input_to_surface']['median']:.3g} (median), "
        f"{fit['iterations']} iterations, {seconds:.0f} s"
    )
