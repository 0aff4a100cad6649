"""The shapes that the presets are measured on, and what they are to reach."""

from __future__ import annotations

from pathlib import Path

from mpf_core.experiments.shapes import PLATE_THICKNESSES
from mpf_core.experiments.trial import Trial

PRESETS = ("draft", "balanced")
SHEETS = ("wave", "hat", "saddle", "moebius", "leaf", "dress")
BODIES = ("spot.obj", "boot.obj", "wingnut.obj", "vtk_goblet_vase.stl")
FLOWER, HELMET = "dipole_flower.xyz", "saxilby_helmet.xyz"
NOISE = 0.005


def trials(meshes: Path | None, clouds: Path | None) -> list[Trial]:
    """Every row of the table, for each preset; files that are not there are left out."""
    return [
        Trial(
            f"{one.label}, {preset}", one.shape, one.points,
            noise=one.noise, options=(("preset", preset),),
        )
        for preset in PRESETS
        for one in _clouds(meshes, clouds)
    ]  # fmt: skip


def _clouds(meshes: Path | None, clouds: Path | None) -> list[Trial]:
    exact = [Trial(name, name, 10_000) for name in (*SHEETS, "cube-sheet")]
    exact += [Trial(f"plate {t:g}", f"plate-{t:g}", 10_000) for t in PLATE_THICKNESSES]
    exact.append(Trial("holed-body", "holed-body", 50_000))
    if meshes is not None:
        found = [meshes / name for name in BODIES if (meshes / name).is_file()]
        exact += [Trial(path.stem, str(path), 50_000) for path in found]
    noisy = [Trial(f"{t.label}, 0.5 %", t.shape, t.points, noise=NOISE) for t in exact]
    scans = []
    for name, points in ((FLOWER, 100_000), (HELMET, 30_000)):
        if clouds is not None and (clouds / name).is_file():
            scans.append(Trial(Path(name).stem, str(clouds / name), points))
    return [*exact, *scans, *noisy]


def goals() -> dict[str, str]:
    """Chamfer × 10³ to reach, by label; input to surface for the scans."""
    goals = {"cube-sheet, draft": "1.0", "cube-sheet, balanced": "0.7 (0.4)"}
    for name in SHEETS:
        goals |= {f"{name}, draft": "2.6", f"{name}, balanced": "1.3"}
    for thickness, goal in zip(PLATE_THICKNESSES, (".26", ".27", ".20", ".23"), strict=True):
        goals[f"plate {thickness:g}, balanced"] = goal
    for name in (*(Path(body).stem for body in BODIES), "holed-body"):
        goals |= {f"{name}, draft": "1.0", f"{name}, balanced": "0.45 (0.3)"}
    for name in (FLOWER, HELMET):
        goals[f"{Path(name).stem}, balanced"] = "0.7, input to surface"
    return goals
