"""The paper's questions as lists of trials."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from mpf_core.experiments import presets
from mpf_core.experiments.shapes import PLATE_THICKNESSES
from mpf_core.experiments.trial import Trial

# A fit of a few seconds: what runs in the tests, and says nothing about quality.
QUICK: dict[str, Any] = {
    "preset": "draft", "max_iterations": 60, "time_budget": 60.0, "resolution": 64, "slices": 0,
}  # fmt: skip
_QUICK_POINTS = 3000

_SHAPES = (
    ("cube-sheet", 10_000), ("wave", 10_000), ("moebius", 10_000), ("vase", 10_000),
    ("hat", 10_000), ("flower", 40_000), ("dress", 20_000), ("ship", 60_000),
    ("lattice", 40_000), ("nested-shells", 40_000), ("spike-ball", 40_000),
    ("t-junction", 10_000), ("x-junction", 10_000), ("bowl", 10_000), ("thin-bowl", 20_000),
    ("leaf", 10_000), ("potted-plant", 60_000),
)  # fmt: skip


@dataclass(frozen=True)
class Experiment:
    """A table: its trials without seeds, at full size or quick, and what the paper says of them,
    or what they are to reach."""

    name: str
    title: str
    trials: Callable[[bool], list[Trial]]
    paper: dict[str, str] = field(default_factory=dict)
    beside: str = "paper"


def _thickness(quick: bool) -> list[Trial]:
    thicknesses = PLATE_THICKNESSES[:1] if quick else PLATE_THICKNESSES
    points = _QUICK_POINTS if quick else 20_000
    solids = [Trial(f"solid, T = {t:g}", f"plate-{t:g}", points) for t in thicknesses]
    return solids if quick else [*solids, Trial("single sheet", "sheet", 10_000)]


def _shapes(quick: bool) -> list[Trial]:
    if quick:
        return [Trial("wave", "wave", _QUICK_POINTS)]
    plain = [Trial(name, name, points) for name, points in _SHAPES]
    return [
        *plain,
        Trial("wave, two-sided 0.02", "wave", 20_000, thickness=0.02),
        Trial("wave, 8 times denser on one side", "wave", 10_000, uneven=8.0),
        Trial("vase, three parts missing", "vase", 10_000, holes=3),
    ]


def _noise(quick: bool) -> list[Trial]:
    if quick:
        return [Trial("wave, 0.5 %", "wave", _QUICK_POINTS, noise=0.005)]
    made = [Trial("room, 0.25 %", "room", 80_000, noise=0.0025)]
    for name, points in (("wave", 10_000), ("cube-sheet", 10_000), ("holed-body", 20_000)):
        levels = (0.0, 0.0025, 0.005, 0.01)
        made += [Trial(f"{name}, {100 * s:g} %", name, points, noise=s) for s in levels]
        made.append(Trial(f"{name}, 1 % outliers", name, points, outliers=0.01))
        made.append(Trial(f"{name}, parts missing", name, points, holes=3))
    return made


def _presets(quick: bool) -> list[Trial]:
    if quick:
        return [Trial("wave", "wave", _QUICK_POINTS)]
    return presets.trials(None, None)


EXPERIMENTS: dict[str, Experiment] = {
    "thickness": Experiment(
        "thickness",
        "Plates of falling thickness",
        _thickness,
        {
            "solid, T = 0.1": ".26",
            "solid, T = 0.05": ".27",
            "solid, T = 0.01": ".20",
            "solid, T = 0.005": ".23",
        },
    ),
    "shapes": Experiment("shapes", "Exact shapes of the paper's kinds", _shapes),
    "noise": Experiment("noise", "Noise, outliers, missing parts, a scene", _noise),
    "presets": Experiment(
        "presets", "The presets against their goals", _presets, presets.goals(), "goal"
    ),
}


def trials(
    name: str,
    *,
    quick: bool,
    seeds: int,
    preset: str | None,
    budget: float | None,
    meshes: Path | None = None,
    clouds: Path | None = None,
) -> list[Trial]:
    """The trials of an experiment, with the options and the seeds asked for.

    meshes, clouds: folders with the files that `presets` names
    """
    options: dict[str, Any] = dict(QUICK) if quick else {}
    if preset is not None:
        options["preset"] = preset
    if budget is not None:
        options["time_budget"] = budget
    base = EXPERIMENTS[name].trials(quick)
    if name == "presets" and not quick:
        base = presets.trials(meshes, clouds)
        if preset is not None:
            base = [t for t in base if dict(t.options)["preset"] == preset]
    made = [replace(t, options=tuple(sorted({**dict(t.options), **options}.items()))) for t in base]
    return [one for t in made for one in t.seeded(1 if quick else seeds)]
