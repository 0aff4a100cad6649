"""A fit watched on its way: `mpf experiment paper` and the moments of `beta`.

At fixed shares of its iterations the field's state is kept, and measured after the fit, so that
looking costs the fit nothing. The fit's own checkpoint lies beside: an experiment that was stopped
goes on in the middle of a fit of hours.
"""

from __future__ import annotations

import json
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors import safe_open
from safetensors.torch import save

from mpf_core.cloud.pointcloud import PointCloud
from mpf_core.errors import SurfaceError
from mpf_core.experiments.asked import SETS, Asked
from mpf_core.experiments.trial import Moment, Outcome, Trial
from mpf_core.field import MetricPhaseField
from mpf_core.files import write_atomically
from mpf_core.fit.control import Control, StepReport
from mpf_core.options import Options, options_from
from mpf_core.parallel import workers
from mpf_core.pipeline import Reconstruction, reconstruct_cloud
from mpf_core.surface.extraction import extract_mesh
from mpf_core.surface.mesh import Mesh
from mpf_core.watch import Snapshot, Watch

LOOKS = (0.02, 0.05, 0.1, 0.2, 0.4, 0.7, 1.0)  # of the planned iterations
CLOUDS = (("cube-sheet", 10_000), ("wave", 10_000))
_LARGEST = 256  # cells along the longest side: what the paper's recipe extracts at


@dataclass(frozen=True)
class State:
    """A kept state of a field: where the fit was, and the weights."""

    iteration: int
    seconds: float
    weights: dict[str, torch.Tensor]


class Recorder(Watch):
    """Keeps states of the field in `folder`, and the fit's checkpoint with them."""

    def __init__(self, folder: Path):
        folder.mkdir(parents=True, exist_ok=True)
        super().__init__(time.monotonic, None, None, checkpoint=folder / "checkpoint")
        self.folder, self.looked = folder, 0

    def control(self, seconds: float, snapshot: Snapshot | None = None) -> Control:
        del snapshot
        return replace(super().control(seconds), snapshot=self._look)

    def on_step(self, step: StepReport) -> None:
        self.last_step = step

    def _look(self, field: MetricPhaseField) -> None:
        step = self.last_step
        assert step is not None
        due = sum(step.iteration >= share * step.planned for share in LOOKS)
        if due <= self.looked:
            return
        self.looked = due
        # Earlier stages of this run, and all of the fit's seconds, interrupted or not.
        seconds = sum(self.seconds.values()) + step.seconds
        told = {"iteration": step.iteration, "seconds": seconds}
        weights = {k: v.detach().clone().contiguous() for k, v in field.state_dict().items()}
        content = save(weights, metadata={"state": json.dumps(told)})
        write_atomically(self.folder / f"{step.iteration}.safetensors", content)


def course(points: NDArray[np.float64], trial: Trial, folder: Path) -> Outcome:
    """Metric-Phase Fields with the trial's options, and the surfaces on the way."""
    options = options_from({"seed": trial.seed, **dict(trial.options)})
    recorder = Recorder(folder / trial.key)
    begin = time.perf_counter()
    result = reconstruct_cloud(PointCloud(points), options, recorder)
    seconds = time.perf_counter() - begin
    fit = result.report["fit"]
    if fit["resumed_from"] is not None:  # what came before is in the fit's own seconds
        seconds = sum(recorder.seconds.values()) - recorder.seconds["fit"] + fit["seconds"]
    with workers(options.threads or torch.get_num_threads()):
        moments = [
            Moment(state.iteration, state.seconds, _surface(state, result, options))
            for state in states(recorder.folder)
        ]
        alone = extract_mesh(result.fitted, options.surface).mesh
    facts = {name: result.report[name] for name in ("timings", "extraction", "fit")}
    return Outcome(result.mesh, facts, alone, seconds, course=moments)


def states(folder: Path) -> list[State]:
    """The states kept in a folder, by iteration."""
    found = []
    for path in folder.glob("*.safetensors"):
        with safe_open(path, framework="pt") as file:
            told = json.loads(file.metadata()["state"])
            weights = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        found.append(State(told["iteration"], told["seconds"], weights))
    return sorted(found, key=lambda state: state.iteration)


def trials(asked: Asked) -> list[Trial]:
    """The paper's recipe and our presets on the same clouds."""
    presets = ("paper", asked.preset) if asked.preset else ("paper", "balanced", "draft")
    if asked.quick:
        presets = ("paper", "draft")
    made = []
    for name, points in CLOUDS[:1] if asked.quick else CLOUDS:
        for preset in presets:
            own: dict[str, Any] = {"preset": preset, "slices": 0}
            if asked.quick:
                own |= {"max_iterations": 60, "laplacian_points": 64, "width": 32}
                own |= dict.fromkeys(SETS, 64)
            elif preset == "paper":  # its size is asked for; ours are what they are
                own |= asked.size(own)
            label = f"{name}, {preset}"
            size = 2000 if asked.quick else points
            made.append(Trial(label, name, size, method="course", options=_pairs(own)))
    return made


def _pairs(options: dict[str, Any]) -> tuple[tuple[str, Any], ...]:
    return tuple(sorted(options.items()))


def _surface(state: State, result: Reconstruction, options: Options) -> Mesh | None:
    """The mesh of a kept state, no finer than the paper's; None where there is none."""
    last = result.fitted.field
    field = MetricPhaseField(width=last.width, omega=last.omega, softplus_slope=last.softplus_slope)
    field.load_state_dict(state.weights)
    field.requires_grad_(False)
    resolution = min(options.surface.resolution or _LARGEST, _LARGEST)
    try:
        surface = replace(options.surface, resolution=resolution)
        fitted = replace(result.fitted, field=field)
        return extract_mesh(fitted, surface).mesh
    except SurfaceError:
        return None
