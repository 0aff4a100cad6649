"""`mpf extract` and `mpf slice`: a fitted field used again."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import click

from mpf_core.extraction_options import AXES, FIELDS, extraction_from
from mpf_core.terminal import changes_in, check_output, told_errors


@click.command()
@click.argument("field", type=click.Path(path_type=Path))
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path, dir_okay=False),
              help="Mesh to write: .glb or .ply.")  # fmt: skip
@click.option("--resolution", type=int, help="Grid cells along the longest side.")
@click.option("--threads", type=int, help="CPU threads.")
@click.option("--set", "settings", multiple=True, metavar="NAME=VALUE",
              help="Any other option of the surface by its name.")  # fmt: skip
@click.option("--report", type=click.Path(path_type=Path, dir_okay=False),
              help="JSON file for the report.")  # fmt: skip
def extract(field: Path, output: Path, report: Path | None, **flags: Any) -> None:
    """Take the surface from the fitted FIELD (field.safetensors) again, without refitting."""
    with told_errors(field):
        check_output(output, ".glb", ".ply")
        options = extraction_from(changes_in(flags))
        begin = time.monotonic()
        from mpf_core import outputs, reuse  # load torch
        from mpf_core.field.blendfile import load_field
        from mpf_core.surface.export import write_mesh

        fitted = load_field(field)
        taken = reuse.extract(fitted, options.surface, threads=options.threads)
        write_mesh(taken.mesh, output)
        told = reuse.report_of(fitted, options, taken)
        if report is not None:
            outputs.write_report(told, report)
    surface, cells = told["surface"], told["extraction"]["resolution"]
    shut = "watertight" if surface["watertight"] else f"{surface['boundary_edges']} boundary edges"
    pieces = surface["components"]
    click.echo(
        f"{output}: {surface['faces']} faces, {shut}, {pieces} component{'s'[: pieces != 1]}, "
        f"resolution {cells}, {time.monotonic() - begin:.1f} s"
    )


@click.command("slice")
@click.argument("field_file", metavar="FIELD", type=click.Path(path_type=Path))
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path, dir_okay=False),
              help="Picture to write: .png.")  # fmt: skip
@click.option("--axis", type=click.Choice(AXES), default="z", show_default=True,
              help="The axis that the slice is perpendicular to.")  # fmt: skip
@click.option("--at", type=float,
              help="Place on the axis, in the input's units; the middle if not given.")  # fmt: skip
@click.option("--field", "name", type=click.Choice(FIELDS), default="phi", show_default=True)
def slice_field(field_file: Path, output: Path, axis: str, at: float | None, name: str) -> None:
    """Draw a slice of the fitted FIELD (field.safetensors)."""
    with told_errors(field_file):
        check_output(output, ".png")
        from mpf_core import reuse  # loads torch
        from mpf_core.field.blendfile import load_field
        from mpf_core.files import write_atomically

        picture = reuse.slice_png(load_field(field_file), axis=axis, at=at, name=name)
        write_atomically(output, picture)
    click.echo(str(output))
