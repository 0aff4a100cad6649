"""The paper's questions as lists of trials."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

from mpf_core.experiments import ablation, baselines, course, presets, scaling
from mpf_core.experiments.asked import QUICK_POINTS, Asked
from mpf_core.experiments.shapes import PLATE_THICKNESSES
from mpf_core.experiments.trial import SCANS, Trial
from mpf_core.quality.meshio import EXTENSIONS

BODIES = tuple(f".{kind}" for kind in EXTENSIONS)

_SHAPES = (
    ("cube-sheet", 10_000), ("wave", 10_000), ("moebius", 10_000), ("vase", 10_000),
    ("hat", 10_000), ("flower", 40_000), ("dress", 20_000), ("ship", 60_000),
    ("lattice", 40_000), ("nested-shells", 40_000), ("spike-ball", 40_000),
    ("t-junction", 10_000), ("x-junction", 10_000), ("bowl", 10_000), ("thin-bowl", 20_000),
    ("leaf", 10_000), ("potted-plant", 60_000),
)  # fmt: skip


@dataclass(frozen=True)
class Experiment:
    """A table: its trials without seeds, as asked for, and what the paper says of them, or what
    they are to reach. Where `sized`, the trials have taken the size and the preset that are asked
    for themselves."""

    name: str
    title: str
    trials: Callable[[Asked], list[Trial]]
    paper: dict[str, str] = field(default_factory=dict)
    beside: str = "paper"
    sized: bool = False


def _thickness(asked: Asked) -> list[Trial]:
    thicknesses = PLATE_THICKNESSES[:1] if asked.quick else PLATE_THICKNESSES
    points = QUICK_POINTS if asked.quick else 20_000
    solids = [Trial(f"solid, T = {t:g}", f"plate-{t:g}", points) for t in thicknesses]
    return solids if asked.quick else [*solids, Trial("single sheet", "sheet", 10_000)]


def _shapes(asked: Asked) -> list[Trial]:
    if asked.quick:
        return [Trial("wave", "wave", QUICK_POINTS)]
    if asked.meshes is not None or asked.clouds is not None:
        return _own(asked)
    plain = [Trial(name, name, points) for name, points in _SHAPES]
    return [
        *plain,
        Trial("wave, two-sided 0.02", "wave", 20_000, thickness=0.02),
        Trial("wave, 8 times denser on one side", "wave", 10_000, uneven=8.0),
        Trial("vase, three parts missing", "vase", 10_000, holes=3),
    ]


def _own(asked: Asked) -> list[Trial]:
    """Anyone's bodies and scans: every file of a known kind in the folders."""
    bodies, scans = (
        [] if folder is None else sorted(p for p in folder.iterdir() if p.suffix.lower() in kinds)
        for folder, kinds in ((asked.meshes, BODIES), (asked.clouds, SCANS))
    )
    made = [Trial(path.stem, str(path), 50_000) for path in bodies]
    return made + [Trial(path.stem, str(path), 100_000) for path in scans]


def _noise(asked: Asked) -> list[Trial]:
    if asked.quick:
        return [Trial("wave, 0.5 %", "wave", QUICK_POINTS, noise=0.005)]
    made = [Trial("room, 0.25 %", "room", 80_000, noise=0.0025)]
    for name, points in (("wave", 10_000), ("cube-sheet", 10_000), ("holed-body", 20_000)):
        levels = (0.0, 0.0025, 0.005, 0.01)
        made += [Trial(f"{name}, {100 * s:g} %", name, points, noise=s) for s in levels]
        made.append(Trial(f"{name}, 1 % outliers", name, points, outliers=0.01))
        made.append(Trial(f"{name}, parts missing", name, points, holes=3))
    return made


def _presets(asked: Asked) -> list[Trial]:
    if asked.quick:
        return [Trial("wave", "wave", QUICK_POINTS)]
    made = presets.trials(asked.meshes, asked.clouds)
    return [t for t in made if asked.preset in (None, dict(t.options)["preset"])]


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
    "ablation": Experiment(
        "ablation", "Terms and additions, one at a time", ablation.terms, ablation.CITED
    ),
    "beta": Experiment("beta", "The phase sharpness β", ablation.betas),
    "phase-only": Experiment("phase-only", "φ = P alone", ablation.phase_only),
    "scaling": Experiment("scaling", "Seconds and memory", scaling.trials),
    "baselines": Experiment("baselines", "What people would use instead", baselines.trials),
    "paper": Experiment(
        "paper", "The paper's recipe and ours over time", course.trials, sized=True
    ),
}


def trials(name: str, asked: Asked) -> list[Trial]:
    """The trials of an experiment, with the options and the seeds asked for."""
    wanted = [t for t in EXPERIMENTS[name].trials(asked) if (asked.only or "") in t.label]
    if EXPERIMENTS[name].sized:
        asked = replace(asked, preset=None, iterations=None, points=None)
    made = [_as_asked(t, asked) if t.is_fit else t for t in wanted]
    return [one for t in made for one in t.seeded(1 if asked.quick else asked.seeds)]


def _as_asked(trial: Trial, asked: Asked) -> Trial:
    return replace(trial, options=tuple(sorted(asked.options(dict(trial.options)).items())))
