"""`mpf evaluate`: a mesh against a reference mesh."""

from __future__ import annotations

import json
from pathlib import Path

import click

from mpf_core.errors import InputError


class _BadInput(click.ClickException):
    """An input error as the command line shows it: one sentence, exit code 2."""

    exit_code = 2


@click.command()
@click.argument("mesh", type=click.Path(path_type=Path))
@click.argument("reference_mesh", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print the figures as one JSON object.")
@click.option(
    "--samples",
    type=click.IntRange(100, 10_000_000),
    default=100_000,
    show_default=True,
    help="Area-uniform samples on each of the two meshes.",
)
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True)
def evaluate(mesh: Path, reference_mesh: Path, as_json: bool, samples: int, seed: int) -> None:
    """Measure MESH against REFERENCE_MESH (.ply, .obj, .stl or .glb).

    Distances are from area-uniform samples of the one mesh to the triangles of the other, in the
    frame where the reference's longest side is 2; Chamfer is both ways, halved, × 10³.
    """
    from mpf_core.quality import metrics
    from mpf_core.quality.meshio import read_mesh

    try:
        result = metrics.evaluate(
            read_mesh(mesh), read_mesh(reference_mesh), samples=samples, seed=seed
        )
    except InputError as error:
        raise _BadInput(str(error)) from error
    if as_json:
        click.echo(json.dumps(result.as_dict(), indent=2))
    else:
        click.echo("\n".join(metrics.lines(result)))
