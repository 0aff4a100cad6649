"""Tiles on one machine: progress, cancel, stop, going on, and what is left behind."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from mpf_core.cli import reconstruct as reconstruct_command
from mpf_core.errors import Cancelled
from mpf_core.field.blend import BlendedField
from mpf_core.field.blendfile import load_field
from mpf_core.progress import Progress
from mpf_core.results import reconstruct_file
from mpf_core.reuse_cli import extract, slice_field
from mpf_core.tiles.child import fit_tile_in_time
from tests.mpf_core.clouds import sphere
from tests.mpf_core.tiles.scenes import POOL, SMALL, ball, small, write_cloud

TINY: dict[str, Any] = {"max_iterations": 60, "width": 16, "start_points": 256, "resolution": 32}
TINY |= {"fidelity": "off", "tile_points": 400}


@pytest.fixture(autouse=True)
def _small_pools(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mpf_core.fit.sampler.pool_size", lambda _: POOL // 4)


@pytest.fixture
def cloud(tmp_path: Path) -> Path:
    return write_cloud(sphere(700), tmp_path / "cloud.ply")


def test_a_cancelled_run_goes_on_where_it_was(cloud: Path, tmp_path: Path) -> None:
    options, told = small(**TINY), list[Progress]()
    whole = tmp_path / "whole"
    report = reconstruct_file(cloud, whole, options, progress=told.append)
    assert report["tiles"]["count"] == 2
    fractions = [p.fraction for p in told]
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1
    steps = [(p.iteration, p.iterations) for p in told if p.iteration is not None]
    assert steps == [(k, 120) for k in (20, 40, 60, 80, 100, 120)]

    kept, again = tmp_path / "checkpoint", list[Progress]()
    half = next(p for p in told if p.iteration == 80).fraction
    with pytest.raises(Cancelled):
        reconstruct_file(
            cloud,
            tmp_path / "out",
            options,
            checkpoint=kept,
            progress=again.append,
            cancel=lambda: bool(again) and again[-1].fraction >= half,
        )
    assert not (tmp_path / "out").exists()
    told.clear()
    reconstruct_file(cloud, tmp_path / "out", options, checkpoint=kept, progress=told.append)
    begun = next(p.iteration for p in told if p.iteration is not None)
    assert begun == 100  # neither the first tile nor the second's first steps again
    for name in ("mesh.ply", "field.safetensors"):
        assert (tmp_path / "out" / name).read_bytes() == (whole / name).read_bytes()
    assert not kept.with_name("checkpoint.tiles").exists()


def test_a_wish_to_stop_leaves_a_surface_of_all_tiles(cloud: Path, tmp_path: Path) -> None:
    told: list[Progress] = []
    options = small(**TINY | {"max_iterations": 400, "width": 64})
    report = reconstruct_file(
        cloud, tmp_path / "out", options, progress=told.append,
        stop=lambda: any(p.iteration is not None for p in told),
    )  # fmt: skip
    first, second = report["tiles"]["each"]
    assert (first["stopped_by"], first["iterations"]) == ("cancel", 60)
    assert second["iterations"] <= 150
    assert report["surface"]["watertight"]


def test_what_is_kept_stays_until_the_result_is_written(cloud: Path, tmp_path: Path) -> None:
    options, told = small(**TINY), list[Progress]()
    taken, kept = tmp_path / "taken", tmp_path / "checkpoint"
    taken.touch()
    with pytest.raises(FileExistsError):
        reconstruct_file(cloud, taken, options, checkpoint=kept)
    (run,) = tmp_path.glob("checkpoint.tiles/run-*")
    (run / "plan.json").write_text("{")
    anothers = run.with_name("notes.txt")
    anothers.write_text("mine")
    report = reconstruct_file(
        cloud, tmp_path / "out", options, checkpoint=kept, progress=told.append
    )
    assert not [p for p in told if p.iteration is not None]  # both tiles were fitted
    assert "plan" in report["fit"]["notes"][0]
    assert (anothers.read_text(), run.exists()) == ("mine", False)


def test_a_kept_file_that_is_damaged_costs_one_fit(cloud: Path, tmp_path: Path) -> None:
    options, told = small(**TINY | {"fidelity": "auto", "tile_points": 250}), list[Progress]()
    taken, kept = tmp_path / "taken", tmp_path / "checkpoint"
    taken.touch()
    with pytest.raises(FileExistsError):
        reconstruct_file(cloud, taken, options, checkpoint=kept)
    (run,) = tmp_path.glob("checkpoint.tiles/run-*")
    for name in ("0/patches.safetensors", "1/field.safetensors", "tile-001.safetensors"):
        (run / name).write_bytes((run / name).read_bytes()[:-100])
    report = reconstruct_file(
        cloud, tmp_path / "out", options, checkpoint=kept, progress=told.append
    )
    (note,) = report["fit"]["notes"]
    assert "are made again" in note
    assert {(p.iteration - 1) // 60 for p in told if p.iteration is not None} == {0, 1}
    assert report["tiles"]["count"] == 3
    assert report["surface"]["fidelity"]["applied"]


def test_tiles_that_were_cut_short_serve_only_who_wants_that(cloud: Path, tmp_path: Path) -> None:
    options, kept = small(**TINY | {"max_iterations": 160}), tmp_path / "checkpoint"
    taken, told = tmp_path / "taken", list[Progress]()
    taken.touch()

    def enough() -> bool:
        return any(p.iteration is not None for p in told)

    with pytest.raises(FileExistsError):
        reconstruct_file(cloud, taken, options, checkpoint=kept, progress=told.append, stop=enough)
    told.clear()
    report = reconstruct_file(
        cloud, tmp_path / "out", options, checkpoint=kept, progress=told.append
    )
    assert [one["iterations"] for one in report["tiles"]["each"]] == [160, 160]


def test_a_fit_that_has_begun_ends_with_what_it_has(tmp_path: Path) -> None:
    tile, kept = ball().plan_dir / "tile-000.safetensors", tmp_path / "checkpoint"
    options, told = small(**TINY | {"max_iterations": 400}), list[Progress]()
    with pytest.raises(Cancelled):
        fit_tile_in_time(
            tile, tmp_path, options, checkpoint=kept, progress=told.append,
            cancel=lambda: bool(told) and (told[-1].iteration or 0) >= 100,
        )  # fmt: skip
    report = fit_tile_in_time(tile, tmp_path, options, checkpoint=kept, stop=lambda: True)
    fit = report["fit"]
    assert (fit["resumed_from"], fit["planned_iterations"]) == (100, 400)
    assert fit["stopped_by"] == "cancel"
    assert fit["iterations"] < 150


def test_the_commands_take_a_large_cloud_and_its_field(cloud: Path, tmp_path: Path) -> None:
    field, mesh, again = (tmp_path / name for name in ("f.safetensors", "m.ply", "again.ply"))
    flags = ["-o", str(mesh), "--field", str(field)]
    for name, value in (SMALL | TINY).items():
        flags += ["--set", f"{name}={value}"]
    ran = CliRunner().invoke(reconstruct_command, [str(cloud), *flags])
    assert ran.exit_code == 0, ran.output
    assert "120 iterations" in ran.output
    assert isinstance(load_field(field), BlendedField)
    asked = ["--resolution", "32", "--threads", "1"]
    ran = CliRunner().invoke(extract, [str(field), "-o", str(again), *asked])
    assert ran.exit_code == 0, ran.output
    assert again.read_bytes() == mesh.read_bytes()
    ran = CliRunner().invoke(slice_field, [str(field), "-o", str(tmp_path / "s.png")])
    assert ran.exit_code == 0, ran.output


def test_the_results_are_those_of_any_reconstruction() -> None:
    scene = ball()
    names = {path.name for path in scene.out.iterdir()}
    assert names == {"mesh.glb", "mesh.ply", "field.safetensors", "report.json"}
    report = scene.report
    assert {"options", "input", "frame", "fit", "tiles", "extraction", "surface"} <= set(report)
    assert report["fit"]["iterations"] == 200
    assert report["fit"]["enclosed_regions"] == 1
    assert report["input"]["points"] == 2000
    each = report["tiles"]["each"]
    assert [one["samples"] for one in each] == list(scene.plan.samples)
    assert all(one["stopped_by"] == "iterations" for one in each)
