"""What each part is worth: one term, one addition, one β at a time."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from mpf_core.experiments.asked import QUICK_POINTS, SETS, Asked
from mpf_core.experiments.trial import Trial
from mpf_core.options import PRESETS

# Three clean clouds, on which all is changed; and two on which the start knows less, with noise and
# with holes, on which each term is left out.
SHAPES = (
    Trial("wave", "wave"),
    Trial("cube-sheet", "cube-sheet"),
    Trial("plate-0.05", "plate-0.05"),
)
HARDER = (
    Trial("wave with noise", "wave", noise=0.005),
    Trial("vase, parts missing", "vase", holes=3),
)
TERMS = ("align", "normal", "lap", "phase", "far", "eik_r", "eik_phi", "zero")
FACTORS = (0.0, 10.0)

# What `balanced` has that the paper has not, each with what takes its place. Those without an
# option of their own (sides and orientation known from the start, the band in local-fit distance)
# come with the warm start and go with it.
ADDITIONS: dict[str, dict[str, Any]] = {
    "no warm start": {"warm_start": False, "warm_fraction": 0.0, "align_from": 0.3},
    "Adam for Muon": {"optimizer": "adam"},
    "constant rates": {"schedule": "constant", "terms_rate": 1.0},
    "full rates for the terms": {"terms_rate": 1.0},
    "λ phase of the paper": {"weight_phase": 0.002},
    "λ normal of the paper": {"weight_normal": 0.15, "rim_normals": 1.0},
    "rims drawn as all else": {"rim_draws": 1.0},
    "normals in full at rims": {"rim_normals": 1.0},
    "align in full at folds": {"align_at_folds": True},
    "ω₀ = 30": {"omega": 30.0},
    "no slow waves": {"slow_waves": 0.0},
    "last mean, not the best": {"patience": 0.0},
    "no mean of states": {"averaging": 0.0},
    "φ = r·P, no residual": {"composite": "product"},
}
# The paper's Table 4, a mean over shapes that it does not name.
_TABLE_4 = {
    "as it is": "1.99",
    "λ align × 10": "2.31",
    "λ align × 0": "6.29",
    "λ normal × 10": "2.57",
    "λ normal × 0": "2.33",
    "λ lap × 10": "2.17",
    "λ lap × 0": "4.19",
    "λ phase × 10": "2.08",
    "λ phase × 0": "10.68",
}
CITED = {f"{shape.label}, {label}": value for shape in SHAPES for label, value in _TABLE_4.items()}

BETAS, BETAS_ALONE = (1.0, 50.0, 100.0, 500.0), (0.01, 1.0, 50.0)
THIN = "plate-0.05"


def terms(asked: Asked) -> list[Trial]:
    """Each λ at 0, 1 and 10 times, then each addition left out, from the preset asked for; on the
    harder clouds each term left out."""
    preset = asked.preset or "balanced"
    left_out: dict[str, dict[str, Any]] = {"as it is": {}}
    changed: dict[str, dict[str, Any]] = {"as it is": {}}
    for name in TERMS:
        weight = getattr(PRESETS[preset].fit, f"weight_{name}")
        for factor in FACTORS:
            changed[f"λ {name} × {factor:g}"] = {f"weight_{name}": factor * weight}
        left_out[f"λ {name} × 0"] = {f"weight_{name}": 0.0}
    if preset != "paper":
        changed |= ADDITIONS
    if asked.quick:
        kept = ("as it is", "φ = r·P, no residual")
        small = {label: changed[label] | dict.fromkeys(SETS, 64) for label in kept}
        return _changed(replace(SHAPES[0], points=QUICK_POINTS), small)
    made = [_changed(cloud, changed) for cloud in SHAPES]
    made += [_changed(cloud, left_out) for cloud in HARDER]
    return [one for trials in made for one in trials]


def _changed(cloud: Trial, changed: dict[str, dict[str, Any]]) -> list[Trial]:
    return [
        replace(cloud, label=f"{cloud.label}, {label}", options=tuple(sorted(own.items())))
        for label, own in changed.items()
    ]


def betas(asked: Asked) -> list[Trial]:
    """A thin plate with β from 1 to 500 in the paper's recipe, watched on the way."""
    return [
        _thin(f"β = {beta:g}", {"beta": beta}, asked, "course")
        for beta in (BETAS[:2] if asked.quick else BETAS)
    ]


def phase_only(asked: Asked) -> list[Trial]:
    """A thin plate with φ = P for several β, beside the paper's φ."""
    made = [
        _thin(f"φ = P, β = {beta:g}", {"beta": beta, "composite": "phase"}, asked)
        for beta in (BETAS_ALONE[-1:] if asked.quick else BETAS_ALONE)
    ]
    return [*made, _thin("φ = r·P + θ, β = 50", {}, asked)]


def _thin(label: str, own: dict[str, Any], asked: Asked, method: str = "mpf") -> Trial:
    """The thin plate in the paper's recipe; a quick run's is a small form of it."""
    own = {"preset": "paper", "slices": 0, **own}
    if asked.quick:
        own |= {"max_iterations": 60, "width": 32, "resolution": 32}
        own |= dict.fromkeys(SETS, 64)
        own |= {"laplacian_points": 64}
    points = QUICK_POINTS if asked.quick else 10_000
    return Trial(label, THIN, points, method=method, options=tuple(sorted(own.items())))
