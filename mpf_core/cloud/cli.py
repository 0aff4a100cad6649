"""`mpf inspect`: what the reader makes of a file."""

from __future__ import annotations

import json
from pathlib import Path

import click

from mpf_core.errors import InputError


@click.command()
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print the findings as one JSON object.")
def inspect(file: Path, as_json: bool) -> None:
    """Say what the reader makes of FILE (.ply, .xyz, .txt, .csv, .pts, .asc or .pwn).

    Prints format and dialect, points, columns and what they were taken for, extents, spacing and
    warnings. The exit code is 0, or 2 with code, message, where and advice if FILE cannot be read.
    """
    from mpf_core.cloud.inspection import inspect_cloud, lines

    try:
        found = inspect_cloud(file)
    except InputError as error:
        if as_json:
            click.echo(json.dumps(error.as_dict(), indent=2, ensure_ascii=False))
        else:
            for label, text in error.as_dict().items():
                if text is not None:
                    click.echo(f"{label:<9} {text}", err=True)
        raise click.exceptions.Exit(2) from error
    if as_json:
        click.echo(json.dumps(found.as_dict(), indent=2, ensure_ascii=False))
    else:
        click.echo("\n".join(lines(found)))
