"""`stop` ends the fit and keeps its surface, `cancel` ends everything; both may be asked often."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mpf_core.errors import Cancelled
from mpf_core.options import Options, options_from
from mpf_core.progress import Progress
from mpf_core.results import reconstruct_file

OPTIONS: Options = options_from(
    {"max_iterations": 100_000, "time_budget": 600, "width": 16, "resolution": 16, "slices": 0}
    | dict.fromkeys(("surface_points", "near_points", "far_points", "start_points"), 32)
    | {"laplacian_points": 8, "threads": 1}
)


class Caller:
    """Wants the end once the fit has come to some iteration."""

    def __init__(self) -> None:
        self.wants = False
        self.asked = 0

    def progress(self, progress: Progress) -> None:
        self.wants = self.wants or (progress.iteration or 0) >= 60

    def check(self) -> bool:
        self.asked += 1
        return self.wants


@pytest.fixture
def cloud(tmp_path: Path) -> Path:
    points = np.random.default_rng(0).normal(size=(300, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    path = tmp_path / "sphere.xyz"
    np.savetxt(path, points)
    return path


def test_a_stopped_fit_gives_the_surface_it_has(cloud: Path, tmp_path: Path) -> None:
    caller = Caller()
    report: dict[str, Any] = reconstruct_file(
        cloud, tmp_path / "out", OPTIONS, progress=caller.progress, stop=caller.check
    )
    assert report["fit"]["stopped_by"] == "cancel"
    assert report["fit"]["iterations"] == 60
    assert report["fit"]["planned_iterations"] > 60
    assert (tmp_path / "out" / "mesh.glb").stat().st_size > 0
    assert caller.asked == 61


def test_a_cancelled_fit_leaves_nothing(cloud: Path, tmp_path: Path) -> None:
    caller, other = Caller(), Caller()
    with pytest.raises(Cancelled) as caught:
        reconstruct_file(
            cloud,
            tmp_path / "out",
            OPTIONS,
            progress=caller.progress,
            stop=other.check,
            cancel=caller.check,
        )
    assert caught.value.where == "iteration 60"
    assert not (tmp_path / "out").exists()


def test_cancel_goes_before_stop(cloud: Path, tmp_path: Path) -> None:
    caller = Caller()
    with pytest.raises(Cancelled):
        reconstruct_file(
            cloud,
            tmp_path / "out",
            OPTIONS,
            progress=caller.progress,
            stop=caller.check,
            cancel=caller.check,
        )
