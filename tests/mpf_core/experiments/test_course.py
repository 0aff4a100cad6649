"""A watched fit: looks at fixed shares, states that survive a stop, curves and their comparison."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image

from mpf_core.errors import Cancelled
from mpf_core.experiments import course, plots, suite, tables, trial
from mpf_core.experiments.asked import Asked
from mpf_core.experiments.cli import experiment
from mpf_core.experiments.shapes import shape
from mpf_core.experiments.trial import Moment, Outcome, Trial
from mpf_core.surface.mesh import Mesh

TINY: dict[str, Any] = {
    "preset": "paper", "max_iterations": 100, "resolution": 32, "slices": 0, "width": 16,
    "surface_points": 32, "near_points": 32, "far_points": 32, "laplacian_points": 16,
    "threads": 1,
}  # fmt: skip
ONE = Trial("sphere", "sphere", 800, method="course", options=tuple(sorted(TINY.items())))


def test_looks_are_at_shares_of_the_plan(tmp_path: Path) -> None:
    outcome = course.course(ONE.cloud(), ONE, tmp_path)
    # The loop reports every twentieth iteration: 2, 5, 10 and 20 % of a hundred are seen there.
    assert [m.iteration for m in outcome.course] == [20, 40, 80, 100]
    seconds = [m.seconds for m in outcome.course]
    assert seconds == sorted(seconds)
    assert seconds[0] > 0
    assert outcome.seconds is not None
    assert outcome.seconds > seconds[-1]
    assert outcome.course[-1].mesh is not None
    # Nothing moves after the last look: the network's own surface is the one delivered.
    assert outcome.alone is not None
    assert np.array_equal(outcome.course[-1].mesh.vertices, outcome.alone.vertices)


def test_a_stopped_fit_goes_on_where_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = course.course(ONE.cloud(), ONE, tmp_path / "whole")
    recorder = course.Recorder

    class Stopped(recorder):
        """Cancelled at iteration 60, as Ctrl-C or a power cut would."""

        def __init__(self, folder: Path):
            super().__init__(folder)
            self.cancel = lambda: self.last_step is not None and self.last_step.iteration >= 60

    monkeypatch.setattr(course, "Recorder", Stopped)
    with pytest.raises(Cancelled):
        course.course(ONE.cloud(), ONE, tmp_path / "parts")
    assert [s.iteration for s in course.states(tmp_path / "parts" / ONE.key)] == [20, 40]
    monkeypatch.setattr(course, "Recorder", recorder)
    parts = course.course(ONE.cloud(), ONE, tmp_path / "parts")
    assert parts.facts["fit"]["resumed_from"] == 60
    assert [m.iteration for m in parts.course] == [m.iteration for m in whole.course]
    assert np.array_equal(parts.mesh.vertices, whole.mesh.vertices)
    assert parts.seconds is not None
    assert parts.seconds > parts.course[-1].seconds


def lifted(by: float) -> Mesh:
    exact = shape("sheet")
    return Mesh(exact.vertices + np.array([0, 0, by]), exact.faces)


def rows_of(tmp_path: Path) -> list[trial.Row]:
    """A slow method that ends at 1, and a fast one that ends at 2, both × 10⁻³ off."""

    def slow(points: Any, one: Trial) -> Outcome:
        off = ((10, 5.0, None), (20, 10.0, 0.004), (40, 20.0, 0.002), (100, 50.0, 0.001))
        moments = [Moment(i, s, None if z is None else lifted(z)) for i, s, z in off]
        return Outcome(lifted(0.001), seconds=51.0, course=moments)

    def fast(points: Any, one: Trial) -> Outcome:
        return Outcome(lifted(0.002), seconds=10.0, course=[Moment(9, 8.0, lifted(0.003))])

    made = [
        Trial("sheet, paper", "sheet", 300, method="slow"),
        Trial("sheet, draft", "sheet", 300, method="fast"),
    ]
    return list(trial.run(made, tmp_path, {"slow": slow, "fast": fast}, samples=500))


def test_equal_seconds_and_equal_chamfer(tmp_path: Path) -> None:
    text = tables.course_markdown(rows_of(tmp_path))
    assert "| sheet, paper | 10 | 5 | no surface |" in text
    assert "| sheet, paper | 40 | 20 | 2 | 1 |" in text
    # The fast one has 2 after 10 s; the slow one 4 by then, and 2 after 20 s.
    assert "sheet, draft: 2.00 after 10 s. sheet, paper: 4 by then" in text
    assert "as good after 2.0 times as long (1.00 at its end, 50 s)" in text
    assert tables.course_markdown([{"metrics": {}}]) == ""


def test_curves_and_pictures_on_the_way(tmp_path: Path) -> None:
    rows = rows_of(tmp_path)
    picture = plots.chamfer_over_time(rows)
    assert picture is not None
    (tmp_path / "curve.png").write_bytes(picture)
    assert Image.open(tmp_path / "curve.png").size[0] > 600
    assert plots.chamfer_over_time([{"metrics": {}}]) is None
    sheet = tables.course_sheet(rows, tmp_path)
    assert sheet is not None
    assert sheet.width == 3 * 520 + 2 * 16  # three moments of the first had a surface
    assert json.loads((tmp_path / "rows" / f"{rows[0]['key']}.json").read_text()) == rows[0]


def test_the_papers_size_is_asked_for_and_ours_is_not() -> None:
    made = suite.trials("paper", Asked(iterations=500, points=256))
    by_preset = {dict(t.options)["preset"]: dict(t.options) for t in made}
    assert by_preset["paper"]["max_iterations"] == 500
    assert by_preset["paper"]["surface_points"] == 256
    assert "max_iterations" not in by_preset["balanced"]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["paper", "beta"])
def test_the_quick_forms(tmp_path: Path, name: str) -> None:
    told = CliRunner().invoke(experiment, [name, "--quick", "--out", str(tmp_path / "out")])
    assert told.exit_code == 0, told.output
    assert "on the way" in told.output
    assert (tmp_path / "out" / "chamfer-over-time.png").is_file()
    rows = json.loads((tmp_path / "out" / "rows.json").read_text())
    assert all(row["course"][-1]["iteration"] == 60 for row in rows)
