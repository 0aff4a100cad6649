"""The `mpf` command: assembled from the entry points of group `mpf.commands`, and `reconstruct`."""

from __future__ import annotations

import sys
import time
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

import click

from mpf_core.errors import Cancelled, FitError, InputError, MPFError, OptionsError
from mpf_core.options import PRESET_NAMES, options_from
from mpf_core.progress import Progress

EXIT_INPUT, EXIT_FIT, EXIT_CANCELLED = 2, 3, 130


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
@click.option("--seed", type=int, help="Seed of every random draw.")
@click.option("--threads", type=int, help="CPU threads.")
@click.option("--set", "settings", multiple=True, metavar="NAME=VALUE",
              help="Any other option by its name, e.g. --set omega=30.")  # fmt: skip
@click.option("--slices", type=click.Path(path_type=Path, file_okay=False),
              help="Folder for φ-slice pictures.")  # fmt: skip
@click.option("--report", type=click.Path(path_type=Path, dir_okay=False),
              help="JSON file for the report.")  # fmt: skip
def reconstruct(
    input: Path, output: Path, slices: Path | None, report: Path | None, **flags: Any
) -> None:
    """Reconstruct the surface of the point cloud INPUT (.ply, .xyz)."""
    try:
        _reconstruct(input, output, slices, report, flags)
    except KeyboardInterrupt:
        sys.exit(_fail(Cancelled("interrupted"), EXIT_CANCELLED))
    except InputError as error:
        sys.exit(_fail(error, EXIT_INPUT))
    except Cancelled as error:
        sys.exit(_fail(error, EXIT_CANCELLED))
    except (FitError, MPFError) as error:
        sys.exit(_fail(error, EXIT_FIT))
    except OSError as error:
        name = error.filename or input
        sys.exit(_fail(InputError(f"{error.strerror or error}", where=str(name)), EXIT_INPUT))


def _fail(error: MPFError, code: int) -> int:
    click.echo(f"mpf: {error} [{error.code}]", err=True)
    return code


def _reconstruct(
    input: Path, output: Path, slices: Path | None, report: Path | None, flags: dict[str, Any]
) -> None:
    writer = output.suffix.lower()
    if writer not in (".glb", ".ply"):
        raise OptionsError(
            f"{output.name} is neither .glb nor .ply", where="--output", advice="Name one of them."
        )
    if not output.parent.is_dir():
        raise OptionsError(
            f"there is no folder {output.parent}", where="--output", advice="Make it first."
        )
    options = options_from(_changes(flags))
    clock_start = time.monotonic()
    from mpf_core import pipeline, results  # load torch
    from mpf_core.cloud.reader import read_cloud
    from mpf_core.surface.export import write_glb, write_ply
    from mpf_core.watch import Watch

    line = _ProgressLine()
    watch = Watch(time.monotonic, line.show, None, begin=clock_start)
    watch.enter("read")
    result = pipeline.reconstruct_cloud(read_cloud(input), options, watch)
    (write_glb if writer == ".glb" else write_ply)(result.mesh, output)
    line.end()
    seconds = time.monotonic() - clock_start
    if slices is not None:
        slices.mkdir(parents=True, exist_ok=True)
        results.write_field_slices(result, options.surface.slices, slices)
    if report is not None:
        results.write_report(result.report, report)
    click.echo(summary(result.report, output, seconds))


def _changes(flags: dict[str, Any]) -> dict[str, Any]:
    """Option names to values: flags that were given, and --set NAME=VALUE read as JSON or text."""
    import json

    changes = {name: value for name, value in flags.items() if value is not None}
    for setting in changes.pop("settings", ()):
        name, equals, text = setting.partition("=")
        if not equals:
            raise OptionsError(f"--set {setting!r} has no '='", advice="Write --set NAME=VALUE.")
        try:
            changes[name] = json.loads(text)
        except ValueError:  # not JSON, or a number of more digits than Python reads
            changes[name] = text
    return changes


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


class _ProgressLine:
    """One live line on a terminal; a plain line every few seconds elsewhere."""

    EVERY = 5.0  # seconds between plain lines

    def __init__(self) -> None:
        self.live = sys.stderr.isatty()
        self.last_stage, self.last_time = "", -1e9

    def show(self, progress: Progress) -> None:
        text = self.text(progress)
        if self.live:
            click.echo(f"\r\033[K{text}", nl=False, err=True)
        elif progress.stage != self.last_stage or (progress.seconds - self.last_time >= self.EVERY):
            self.last_stage, self.last_time = progress.stage, progress.seconds
            click.echo(text, err=True)

    def text(self, progress: Progress) -> str:
        parts = [f"{progress.fraction:4.0%}  {progress.stage}"]
        if progress.iteration is not None:
            parts.append(f"{progress.iteration}/{progress.iterations}")
        if progress.loss is not None:
            parts.append(f"loss {progress.loss:.4f}")
        if progress.eta is not None:
            parts.append(f"{progress.eta:.0f} s left")
        return "  ".join(parts)

    def end(self) -> None:
        if self.live:
            click.echo("\r\033[K", nl=False, err=True)
