"""Experiments with methods whose answer is known: rows, tables, pictures, resuming."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from numpy.typing import NDArray

from mpf_core.errors import NoSurface
from mpf_core.experiments import suite, tables, trial
from mpf_core.experiments.cli import EXPERIMENTS, experiment
from mpf_core.experiments.shapes import SHAPES, shape
from mpf_core.experiments.trial import METHODS, Outcome, Trial
from mpf_core.options import options_from
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


def test_keys_tell_trials_apart() -> None:
    every = [t for name in EXPERIMENTS for t in suite.EXPERIMENTS[name].trials(False)]
    seeded = [s for t in every for s in t.seeded(2)]
    assert len({t.key for t in seeded}) == len(set(seeded))


@pytest.mark.parametrize("name", suite.EXPERIMENTS)
def test_every_experiment_can_be_asked_for(name: str) -> None:
    assert name in EXPERIMENTS
    for quick in (True, False):
        made = suite.trials(name, quick=quick, seeds=3, preset=None, budget=20.0)
        assert all(t.shape in SHAPES for t in made)
        assert {t.seed for t in made} == ({0} if quick else {0, 1, 2})
        labels = [t.label for t in made if t.seed == 0]
        assert len(labels) == len(set(labels))
        assert options_from(dict(made[0].options)).fit.time_budget == 20.0
    assert set(suite.EXPERIMENTS[name].paper) <= {
        t.label for t in suite.EXPERIMENTS[name].trials(False)
    }


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
    assert "`mpf experiment noise --quick --seeds=1` on" in told.output
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
def test_the_quick_form_of_a_real_experiment(tmp_path: Path) -> None:
    pytest.importorskip("mpf_core.pipeline")
    told = CliRunner().invoke(experiment, ["thickness", "--quick", "--out", str(tmp_path)])
    assert told.exit_code == 0, told.output
    assert (tmp_path / "sheet.png").is_file()
