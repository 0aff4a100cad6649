"""What others make of the same clouds; skipped in part where Open3D is not installed."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from mpf_core.experiments import baselines, presets, suite
from mpf_core.experiments.asked import Asked
from mpf_core.experiments.cli import experiment
from mpf_core.experiments.shapes import sample, shape
from mpf_core.experiments.trial import Trial
from mpf_core.quality.metrics import compare
from mpf_core.quality.topology import topology


def test_without_open3d_the_command_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "open3d", None)
    told = CliRunner().invoke(experiment, ["baselines", "--quick", "--out", str(tmp_path)])
    assert told.exit_code == 2
    assert "pip install 'metric-phase-fields[bench]'" in " ".join(told.output.split())
    assert not (tmp_path / "rows").exists()


def test_they_meet_the_clouds_of_the_presets() -> None:
    ours = [t for t in presets.trials(None, None) if dict(t.options)["preset"] == "draft"]
    made = suite.trials("baselines", Asked())
    for name in baselines.BASELINES:
        theirs = [t for t in made if t.method == name]
        assert len(theirs) == len(ours)
        for one, other in zip(theirs, ours, strict=True):
            assert (one.shape, one.points, one.noise) == (other.shape, other.points, other.noise)
            assert one.options == ()
    assert not any(t.is_fit for t in made)
    also = suite.trials("baselines", Asked(preset="draft"))
    assert {t.method for t in also if t.is_fit} == {"mpf"}


@pytest.fixture
def ball() -> tuple[np.ndarray, Trial]:
    pytest.importorskip("open3d", exc_type=ImportError)
    return sample("sphere", 3000, 0), Trial("sphere", "sphere", 3000)


@pytest.mark.parametrize("name", baselines.BASELINES)
def test_each_finds_a_sphere(ball: tuple[np.ndarray, Trial], name: str) -> None:
    found = baselines.BASELINES[name](*ball)
    off = compare(found.mesh, shape("sphere"), samples=2000)
    assert off.to_reference < 5
    # The balls through four samples of a sphere are all as large as it: its alpha shape is in rags.
    assert off.to_mesh < 5 or name == "alpha shape"
    assert found.seconds is not None
    assert found.seconds > 0
    assert found.figures["processor_seconds"] > 0


def test_only_the_trimmed_poisson_ends_where_the_samples_end(
    ball: tuple[np.ndarray, Trial],
) -> None:
    points = ball[0][ball[0][:, 2] > 0.2]
    whole, trimmed = (
        f(points, ball[1]).mesh for f in (baselines.poisson, baselines.poisson_trimmed)
    )
    assert topology(trimmed).boundary_edges > 0
    assert trimmed.vertices[:, 2].min() > whole.vertices[:, 2].min()
    assert trimmed.vertices[:, 2].min() == pytest.approx(0.2, abs=0.12)


def test_the_quick_form(tmp_path: Path) -> None:
    pytest.importorskip("open3d", exc_type=ImportError)
    told = CliRunner().invoke(experiment, ["baselines", "--quick", "--out", str(tmp_path)])
    assert told.exit_code == 0, told.output
    for name in baselines.BASELINES:
        assert f"| wave, 0.5 % | {name} |" in told.output
    assert (tmp_path / "sheet.png").is_file()
