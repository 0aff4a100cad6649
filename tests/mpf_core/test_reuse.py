"""A fitted field used again: the very mesh of its run, slices, and what a terminal says."""

from __future__ import annotations

import io
import json
from functools import cache, partial
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from click.testing import CliRunner, Result
from PIL import Image

from mpf_core import Reconstruction, load_field, options_from, reconstruct, reuse, save_field
from mpf_core.cli import reconstruct as reconstruct_command
from mpf_core.errors import Cancelled, NoSurface, OptionsError, OutsideBox
from mpf_core.extraction_options import extraction_from
from mpf_core.fit.sampler import warm_pools
from mpf_core.options import SurfaceOptions
from mpf_core.reuse_cli import extract, slice_field
from tests.mpf_core.clouds import sphere

CENTER = np.array([691_607.0, 5_334_760.0, 512.0])
SMALL: dict[str, Any] = {"width": 16, "omega": 5.0, "max_iterations": 30, "resolution": 24}
SMALL |= {"threads": 1, "start_points": 512, "slices": 1, "time_budget": 600.0, "fidelity": "off"}


@cache
def fitted() -> Reconstruction:
    points = sphere(300, 30.0) + CENTER
    colors = np.where(points[:, 2:] > 512, [[255, 0, 0]], [[0, 0, 255]]).astype(np.uint8)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mpf_core.pipeline.warm_pools", partial(warm_pools, size=10_000))
        return reconstruct(points, options_from(SMALL), colors=colors)


@pytest.fixture
def result() -> Reconstruction:
    return fitted()


@pytest.fixture
def field(tmp_path: Path, result: Reconstruction) -> Path:
    path = tmp_path / "field.safetensors"
    save_field(result.fitted, path)
    return path


def test_the_reloaded_field_gives_the_same_mesh_bit_for_bit(
    field: Path, result: Reconstruction
) -> None:
    taken = reuse.extract(load_field(field), SurfaceOptions(resolution=24), threads=1)
    before, after = result.mesh, taken.mesh
    assert len(before.faces) > 500
    assert np.array_equal(before.vertices, after.vertices)
    assert np.array_equal(before.faces, after.faces)
    assert before.normals is not None
    assert np.array_equal(before.normals, after.normals)
    assert before.colors is not None
    assert after.colors is not None
    # Colours are mixed by distances to samples that the file rounds.
    assert np.abs(before.colors.astype(int) - after.colors.astype(int)).max() <= 2
    told = result.report["extraction"]
    assert taken.report == told | {"reason": "as asked"}


def test_the_resolution_is_chosen_as_the_run_would(result: Reconstruction) -> None:
    chosen = reuse.extract(result.fitted, SurfaceOptions()).report
    assert chosen["resolution"] == 96
    assert "raised to 96" in chosen["reason"]


def test_files_of_an_extraction(field: Path, tmp_path: Path, result: Reconstruction) -> None:
    asked = {
        "resolution": 24,
        "threads": 1,
        "slices": 1,
        "cuts": [
            {"axis": "z", "field": "r", "at": [512.0, 520.5]},
            {"axis": "z", "field": "r", "count": 1},
            {"axis": "x", "field": "P", "count": 2},
        ],
    }
    stages: list[str] = []
    out = tmp_path / "new" / "out"
    report = reuse.extract_file(
        field, out, extraction_from(asked), progress=lambda p: stages.append(p.stage)
    )
    written = {str(p.relative_to(out)) for p in out.rglob("*") if p.is_file()}
    stack = {f"slices/{axis}/0.png" for axis in "xyz"}
    cuts = {*(f"slices/r/z/{k}.png" for k in range(3)), *(f"slices/P/x/{k}.png" for k in (0, 1))}
    assert written == {"mesh.glb", "mesh.ply", "report.json"} | stack | cuts
    assert json.loads((out / "report.json").read_text("utf-8")) == report
    assert {one["file"] for one in report["slices"]} == stack | cuts
    at = {one["file"]: one["at"] for one in report["slices"]}
    assert at["slices/r/z/1.png"] == pytest.approx(520.5)
    assert at["slices/r/z/2.png"] == pytest.approx(512, abs=1)
    assert (report["options"]["resolution"], report["extraction"]["resolution"]) == (24, 24)
    told, before = report["surface"], result.report["surface"]
    assert told["faces"] == before["faces"]
    # To the samples as the file keeps them, rounded to a hundred-thousandth.
    median = before["input_to_surface"]["median"]
    assert told["input_to_surface"]["median"] == pytest.approx(median, rel=1e-3)
    assert stages == ["read", "extract", "slices", "report", "done"]
    assert set(report["timings"]) == {"read", "extract", "slices"}


def test_slices_alone_need_no_mesh(field: Path, tmp_path: Path) -> None:
    asked = {"mesh": False, "cuts": [{"axis": "y", "count": 1}]}
    report = reuse.extract_file(field, tmp_path / "out", extraction_from(asked))
    assert "surface" not in report
    assert not (tmp_path / "out" / "mesh.glb").exists()
    with pytest.raises(Cancelled):
        reuse.extract_file(field, tmp_path / "x", extraction_from(asked), cancel=lambda: True)


def test_every_field_is_drawn_where_asked(result: Reconstruction) -> None:
    pictures = {
        name: reuse.slice_png(result.fitted, axis="z", at=512.0, name=name)
        for name in ("phi", "r", "theta", "P")
    }
    assert len(set(pictures.values())) == 4
    image = np.asarray(Image.open(io.BytesIO(pictures["phi"])).convert("RGB")).astype(int)
    inside, outside = image[18 + 400, 18 + 400], image[30, 30]
    assert inside[2] > inside[0]
    assert outside[0] > outside[2]
    corners = result.fitted.similarity.to_input(result.fitted.box)
    for place in corners[:, 1]:
        assert reuse.slice_png(result.fitted, axis="y", at=float(f"{place:.10g}"))
    with pytest.raises(OptionsError):
        reuse.slice_png(result.fitted, axis="w")


@pytest.mark.parametrize("at", [0.0, 440.0, 1e300, float("nan")])
def test_a_slice_outside_the_box_is_refused_with_the_range(
    field: Path, tmp_path: Path, result: Reconstruction, at: float
) -> None:
    with pytest.raises(OutsideBox) as told:
        reuse.slice_png(result.fitted, axis="z", at=at)
    assert told.value.advice
    assert "48" in told.value.advice  # from about 480
    if np.isfinite(at) and at < 1e100:
        asked = {"cuts": [{"axis": "z", "at": [512.0, at]}]}
        with pytest.raises(OutsideBox):
            reuse.extract_file(field, tmp_path / "out", extraction_from(asked))
        assert not (tmp_path / "out").exists()


def test_a_field_without_a_zero_level_says_so(result: Reconstruction, tmp_path: Path) -> None:
    path = tmp_path / "f.safetensors"
    save_field(result.fitted, path)
    empty = load_field(path)
    empty.field.siren.phase_offset.fill_(1e6)
    with pytest.raises(NoSurface) as told:
        reuse.extract(empty, SurfaceOptions(resolution=16))
    assert told.value.advice


# In a terminal


def run(command: Any, *arguments: str | Path) -> Result:
    return CliRunner().invoke(command, [str(argument) for argument in arguments])


def complaint(result: Result, code: int = 2) -> str:
    assert result.exit_code == code, result.output
    assert "Traceback" not in result.output
    return result.stderr


def test_the_commands_are_declared() -> None:
    declared = (Path(__file__).parents[2] / "pyproject.toml").read_text()
    assert 'extract = "mpf_core.reuse_cli:extract"' in declared
    assert 'slice = "mpf_core.reuse_cli:slice_field"' in declared
    assert {point.name for point in entry_points(group="mpf.commands")} >= {"reconstruct"}


def test_reconstruct_keeps_the_field_and_extract_takes_the_mesh_again(tmp_path: Path) -> None:
    cloud = tmp_path / "cloud.xyz"
    np.savetxt(cloud, sphere(200))
    settings = ["--max-iterations", "20", "--threads", "1", "--set", "width=16"]
    settings += ["--set", "start_points=512", "--resolution", "24", "--set", "fidelity=off"]
    kept, first, again = (tmp_path / n for n in ("f.safetensors", "a.ply", "b.ply"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mpf_core.pipeline.warm_pools", partial(warm_pools, size=10_000))
        made = run(reconstruct_command, cloud, "-o", first, "--field", kept, *settings)
    assert made.exit_code == 0, made.output
    report = tmp_path / "report.json"
    taken = run(extract, kept, "-o", again, "--resolution", 24, "--threads", 1, "--report", report)
    assert taken.exit_code == 0, taken.output
    assert first.read_bytes() == again.read_bytes()
    faces = len(trimesh.load(again, force="mesh").faces)
    assert f"{faces} faces" in taken.stdout
    assert json.loads(report.read_text())["surface"]["faces"] == faces


def test_a_picture_of_a_slice(field: Path, tmp_path: Path) -> None:
    out = tmp_path / "z.png"
    made = run(slice_field, field, "--axis", "z", "--at", "515", "--field", "theta", "-o", out)
    assert made.exit_code == 0, made.output
    assert Image.open(out).format == "PNG"


def test_mistakes_are_told_in_a_sentence(field: Path, tmp_path: Path) -> None:
    mesh, picture = tmp_path / "o.glb", tmp_path / "o.png"
    other = tmp_path / "other.safetensors"
    other.write_bytes(b"ply\n")
    assert "[field.format]" in complaint(run(extract, other, "-o", mesh))
    assert "absent" in complaint(run(extract, tmp_path / "absent", "-o", mesh))
    assert str(tmp_path) in complaint(run(extract, tmp_path, "-o", mesh))
    assert ".glb" in complaint(run(extract, field, "-o", tmp_path / "o.obj"))
    assert "resolution" in complaint(run(extract, field, "-o", mesh, "--resolution", 3))
    assert "omega" in complaint(run(extract, field, "-o", mesh, "--set", "omega=3"))
    assert "[options.outside_box]" in complaint(run(slice_field, field, "--at=7", "-o", picture))
    assert ".png" in complaint(run(slice_field, field, "-o", mesh))
    assert not mesh.exists()
    assert not picture.exists()
