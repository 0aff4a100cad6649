"""Experiments with methods whose answer is known: rows, tables, pictures, resuming."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from numpy.typing import NDArray

from mpf_core.cloud.pointcloud import PointCloud
from mpf_core.errors import NoSurface
from mpf_core.experiments import ablation, presets, running, suite, tables, trial
from mpf_core.experiments.asked import Asked
from mpf_core.experiments.cli import EXPERIMENTS, experiment
from mpf_core.experiments.shapes import SHAPES, shape
from mpf_core.experiments.trial import METHODS, Outcome, Trial
from mpf_core.options import options_from, options_to_mapping
from mpf_core.surface.export import cloud_ply_bytes, write_ply
from mpf_core.surface.mesh import Mesh

Points = NDArray[np.float64]


def lifted(points: Points, one: Trial) -> Outcome:
    """The exact shape, 0.003 too high."""
    exact = shape(one.shape)
    return Outcome(
        Mesh(exact.vertices + np.array([0, 0, 0.003]), exact.faces), {"points": len(points)}
    )


def fails(points: Points, one: Trial) -> Outcome:
    raise NoSurface("the field has no zero level")


SHEET = Trial("sheet", "sheet", points=500)


def test_rows_hold_what_was_asked_and_found(tmp_path: Path) -> None:
    (row,) = trial.run([SHEET], tmp_path, {"mpf": lifted}, samples=1000)
    assert row["metrics"]["chamfer"] == pytest.approx(3.0)
    assert row["trial"]["points"] == row["facts"]["points"] == 500
    assert row["machine"]["numpy"] == np.__version__
    assert tables.mesh_path(tmp_path, row).is_file()
    assert json.loads((tmp_path / "rows" / f"{SHEET.key}.json").read_text()) == row


def test_rows_are_kept_and_failures_tried_again(tmp_path: Path) -> None:
    (failed,) = trial.run([SHEET], tmp_path, {"mpf": fails}, samples=1000)
    assert "no zero level" in failed["error"]
    (done,) = trial.run([SHEET], tmp_path, {"mpf": lifted}, samples=1000)
    (kept,) = trial.run([SHEET], tmp_path, {"mpf": fails}, samples=1000)
    assert kept == done


def test_a_scan_is_measured_by_its_own_points(tmp_path: Path) -> None:
    file = tmp_path / "scan.xyz"
    np.savetxt(file, shape("sphere").vertices * 7 + 3)
    one = Trial("scan", str(file), points=200)

    def unit(points: Points, asked: Trial) -> Outcome:
        assert np.allclose(np.abs(points).max(0), 1, atol=0.05)
        exact = shape("sphere")
        far = exact.vertices[:3] + 5  # a triangle that belongs to nothing
        vertices = np.concatenate([exact.vertices, far])
        faces = np.concatenate([exact.faces, [[len(vertices) - k for k in (3, 2, 1)]]])
        return Outcome(Mesh(vertices, faces), alone=exact, seconds=1.5)

    (row,) = trial.run([one], tmp_path, {"mpf": unit}, samples=1000)
    assert row["seconds"] == 1.5
    assert row["metrics"]["input_to_surface"] < 20
    assert row["metrics"]["components"] == 2
    assert row["metrics"]["farthest_component"] > 10
    assert row["metrics"]["alone_farthest_component"] < 1
    assert "chamfer" not in row["metrics"]
    assert "input to surface" in tables.markdown("Scans", [row], {}, "mpf")


def test_a_ply_without_triangles_is_a_scan(tmp_path: Path) -> None:
    body = shape("sphere")
    cloud, mesh = tmp_path / "cloud.ply", tmp_path / "mesh.ply"
    cloud.write_bytes(cloud_ply_bytes(PointCloud(body.vertices), []))
    write_ply(body, mesh)
    own = suite.trials("shapes", Asked(clouds=tmp_path))
    assert [(Path(t.shape).name, t.is_scan) for t in own] == [
        ("cloud.ply", True),
        ("mesh.ply", False),
    ]
    assert [len(t.cloud()) for t in own] == [len(body.vertices), 100_000]


def test_keys_tell_trials_apart() -> None:
    every = [t for name in suite.EXPERIMENTS for t in suite.EXPERIMENTS[name].trials(Asked())]
    seeded = [s for t in every for s in t.seeded(2)]
    assert len({t.key for t in seeded}) == len(set(seeded))


@pytest.mark.parametrize("name", suite.EXPERIMENTS)
def test_every_experiment_can_be_asked_for(name: str, tmp_path: Path) -> None:
    assert name in EXPERIMENTS
    for quick in (True, False):
        made = suite.trials(name, Asked(quick=quick, seeds=3, budget=20.0))
        assert all(t.shape in SHAPES for t in made)
        assert {t.seed for t in made} == ({0} if quick else {0, 1, 2})
        labels = [(t.label, t.method) for t in made if t.seed == 0]
        assert len(labels) == len(set(labels))
        for one in made:
            if one.is_fit:
                assert options_from(dict(one.options)).fit.time_budget == 20.0
    for file in (*presets.BODIES, presets.FLOWER, presets.HELMET):
        (tmp_path / file).touch()
    full = suite.trials(name, Asked(meshes=tmp_path, clouds=tmp_path))
    assert set(suite.EXPERIMENTS[name].paper) <= {t.label for t in full}


def test_every_name_of_the_command_is_an_experiment() -> None:
    assert set(EXPERIMENTS) == suite.EXPERIMENTS.keys() | running.MEASUREMENTS.keys()


def test_every_method_can_be_found(tmp_path: Path) -> None:
    every = [t for name in suite.EXPERIMENTS for t in suite.EXPERIMENTS[name].trials(Asked())]
    assert {t.method for t in every} <= running.methods(tmp_path).keys()


def test_anyones_files_take_the_place_of_the_shapes(tmp_path: Path) -> None:
    for file in ("chair.obj", "scan.xyz", "notes.md"):
        (tmp_path / file).touch()
    own = suite.trials("shapes", Asked(meshes=tmp_path, clouds=tmp_path))
    assert [Path(t.shape).name for t in own] == ["chair.obj", "scan.xyz"]


def test_iterations_and_points_that_are_asked_for() -> None:
    asked = Asked(iterations=300, points=128, resolution=96)
    for one in suite.trials("beta", asked):
        options = options_from(dict(one.options))
        fit = options.fit
        assert options.surface.resolution == 96
        assert (fit.max_iterations, fit.learning_rate) == (300, 5e-5)
        assert (fit.surface_points, fit.near_points, fit.far_points) == (128, 128, 128)
        assert fit.laplacian_points == 128
    assert "--iterations=300 --points=128 --resolution=96" in asked.command("beta")


def test_an_ablation_changes_one_thing_at_a_time() -> None:
    for preset in ("balanced", "paper"):
        made = suite.trials("ablation", Asked(preset=preset))
        base = options_to_mapping(options_from(dict(made[0].options)))
        of_wave = [t for t in made if t.label.startswith("wave,")]
        for one in of_wave[1:]:
            options = options_to_mapping(options_from(dict(one.options)))
            assert any(options[name] != base[name] for name in dict(one.options)), one.label
        terms = [t.label for t in of_wave if "λ" in t.label and "×" in t.label]
        assert len(terms) == 2 * len(ablation.TERMS)
        assert ("wave, no warm start" in {t.label for t in of_wave}) is (preset == "balanced")


def test_an_ablation_leaves_each_term_out_where_the_start_knows_less() -> None:
    made = suite.trials("ablation", Asked())
    for cloud in ablation.HARDER:
        of_it = [t for t in made if t.label.startswith(f"{cloud.label}, ")]
        assert len(of_it) == 1 + len(ablation.TERMS)
        assert {(t.shape, t.noise, t.holes) for t in of_it} == {
            (cloud.shape, cloud.noise, cloud.holes)
        }
        assert all(v == 0.0 for t in of_it for k, v in t.options if k.startswith("weight_"))


def test_table_has_means_spreads_and_citations(tmp_path: Path) -> None:
    def rises(points: Points, one: Trial) -> Outcome:
        exact = shape("sheet")
        lift = np.array([0, 0, 0.001 * (1 + one.seed)])
        return Outcome(Mesh(exact.vertices + lift, exact.faces))

    rows = list(trial.run(SHEET.seeded(3), tmp_path, {"mpf": rises}, samples=500))
    text = tables.markdown("Sheets", rows, {"sheet": ".26"}, "mpf experiment sheets")
    (line,) = (line for line in text.splitlines() if line.startswith("| sheet"))
    assert "2.00 ± 1.00" in line
    assert line.endswith("| .26 |")
    assert "500 samples" in text
    assert "`mpf experiment sheets`" in text


def test_contact_sheet_in_error_colours(tmp_path: Path) -> None:
    rows = list(trial.run([SHEET], tmp_path, {"mpf": lifted}, samples=500))
    picture = tables.contact_sheet(rows, tmp_path)
    assert picture is not None
    assert picture.size[0] == 520
    assert tables.contact_sheet([], tmp_path) is None


def test_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(METHODS, "mpf", lifted)
    out = tmp_path / "out"
    arguments = ["noise", "--quick", "--out", str(out)]
    told = CliRunner().invoke(experiment, arguments)
    assert told.exit_code == 0, told.output
    assert "| wave, 0.5 % | mpf | " in told.output
    assert "`mpf experiment noise --quick` on" in told.output
    assert {p.name for p in out.iterdir()} == {
        "rows", "meshes", "table.md", "rows.json", "sheet.png",
    }  # fmt: skip
    told = CliRunner().invoke(experiment, [*arguments, "--json"])
    assert json.loads(told.stdout)[0]["trial"]["noise"] == 0.005


def test_command_says_what_is_wrong(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(METHODS, "mpf", fails)
    run = CliRunner().invoke
    failed = run(experiment, ["thickness", "--quick", "--out", str(tmp_path)])
    assert failed.exit_code == 3
    assert "no zero level" in failed.output
    assert run(experiment, ["thickness", "--preset", "best"]).exit_code == 2
    assert run(experiment, ["thickness", "--only", "teapot"]).exit_code == 2
    assert run(experiment, ["magic"]).exit_code == 2


@pytest.mark.slow
@pytest.mark.parametrize("name", ["thickness", "ablation", "phase-only"])
def test_the_quick_form_of_a_real_experiment(tmp_path: Path, name: str) -> None:
    told = CliRunner().invoke(experiment, [name, "--quick", "--out", str(tmp_path)])
    assert told.exit_code == 0, told.output
    assert (tmp_path / "sheet.png").is_file()
