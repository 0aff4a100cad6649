"""A row of `scaling` is a process of its own, measured from outside."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from mpf_core.errors import FitError
from mpf_core.experiments import scaling, suite
from mpf_core.experiments.asked import Asked
from mpf_core.experiments.cli import experiment
from mpf_core.experiments.trial import Trial


def test_one_thing_grows_at_a_time() -> None:
    made = suite.trials("scaling", Asked())
    points = [t.points for t in made if "points" in t.label]
    assert points == sorted(points)
    assert (points[0], points[-1]) == (1_000, 3_000_000)
    options = [dict(t.options) for t in made if "cells" in t.label]
    assert len({o["max_iterations"] for o in options}) == 1
    assert [o["resolution"] for o in options] == sorted(o["resolution"] for o in options)


def test_what_the_command_says_when_it_fails(tmp_path: Path) -> None:
    with pytest.raises(FitError, match=r"mpf reconstruct failed: .*there is no option 'magic'"):
        scaling.process(np.random.default_rng(0).normal(size=(400, 3)), trial_with({"magic": 1}))


def trial_with(options: dict[str, Any]) -> Trial:
    return Trial("one", "sphere", 400, method="process", options=tuple(options.items()))


@pytest.mark.slow
def test_the_peak_is_the_childs_alone() -> None:
    mine = np.ones(200_000_000)  # 1.5 GiB, which a forked child would have had for a moment
    tiny = {"preset": "draft", "max_iterations": 20, "width": 16, "resolution": 32, "threads": 1}
    found = scaling.process(np.random.default_rng(0).normal(size=(400, 3)), trial_with(tiny))
    assert found.figures["peak_mib"] < mine.nbytes / 2**20


@pytest.mark.slow
def test_the_quick_form(tmp_path: Path) -> None:
    told = CliRunner().invoke(experiment, ["scaling", "--quick", "--out", str(tmp_path / "out")])
    assert told.exit_code == 0, told.output
    assert "peak MiB" in told.output
    for row in json.loads((tmp_path / "out" / "rows.json").read_text()):
        found = row["metrics"]
        assert found["iterations"] == 20
        assert 100 < found["peak_mib"] < 2000  # torch alone takes more than 100
        assert row["seconds"] > row["facts"]["timings"]["fit"]
        assert found["chamfer"] > 0
