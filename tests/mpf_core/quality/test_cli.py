"""`mpf evaluate` as a stranger meets it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import trimesh
from click.testing import CliRunner

from mpf_core.quality.cli import evaluate
from mpf_core.quality.meshio import read_mesh
from mpf_core.quality.topology import topology


@pytest.mark.parametrize("kind", ["ply", "obj", "stl", "glb"])
def test_every_format_is_read_and_welded(tmp_path: Path, kind: str) -> None:
    trimesh.creation.icosphere(subdivisions=2).export(tmp_path / f"sphere.{kind}")
    counted = topology(read_mesh(tmp_path / f"sphere.{kind}"))
    assert (counted.faces, counted.watertight, counted.components) == (320, True, 1)


def test_figures_as_json_and_as_text(tmp_path: Path) -> None:
    mesh, reference = tmp_path / "a.ply", tmp_path / "b.stl"
    trimesh.creation.box((2, 2, 2.02)).export(mesh)
    trimesh.creation.box((2, 2, 2)).export(reference)
    arguments = [str(mesh), str(reference), "--samples", "1000"]
    told = CliRunner().invoke(evaluate, [*arguments, "--json"])
    assert told.exit_code == 0, told.output
    figures = json.loads(told.output)
    assert figures["hausdorff"] == pytest.approx(0.01)
    assert figures["samples"] == 1000
    told = CliRunner().invoke(evaluate, arguments)
    assert told.exit_code == 0
    assert "Chamfer" in told.output
    assert "point-to-triangle" in told.output


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("absent.ply", None, "no file"),
        ("mesh.xyz", b"0 0 0\n", "extension"),
        ("broken.ply", b"not a ply", "cannot be read as PLY"),
        ("empty.glb", b"", "cannot be read as GLB"),
        ("points.obj", b"v 0 0 0\nv 1 0 0\n", ""),
        ("nan.obj", b"v 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\n", ""),
        ("index.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", ""),
    ],
)
def test_bad_meshes_end_with_exit_code_2(
    tmp_path: Path, name: str, content: bytes | None, says: str
) -> None:
    good = tmp_path / "good.ply"
    trimesh.creation.box().export(good)
    bad = tmp_path / name
    if content is not None:
        bad.write_bytes(content)
    told = CliRunner().invoke(evaluate, [str(bad), str(good)])
    assert told.exit_code == 2
    assert says in told.output
    assert "Traceback" not in told.output
    assert told.output.count("\n") == 1
