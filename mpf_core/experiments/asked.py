"""What the flags of `mpf experiment` ask for, and what they change in the options of a trial."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Any

# A fit of a few seconds: what runs in the tests, and says nothing about quality.
QUICK: dict[str, Any] = {
    "preset": "draft", "max_iterations": 60, "time_budget": 60.0, "resolution": 32, "slices": 0,
}  # fmt: skip
QUICK_POINTS = 3000
SETS = ("surface_points", "near_points", "far_points")
UNBOUND = 7 * 86_400.0  # s: a number of iterations that is asked for is not cut by the clock


@dataclass(frozen=True)
class Asked:
    """The flags of one command; None where nothing is asked.

    budget: seconds for each fit; iterations: of each fit; points: in each set of a step;
    resolution: cells along the longest side; only: text of the labels wanted; meshes, clouds:
    folders with bodies and scans
    """

    quick: bool = False
    budget: float | None = None
    seeds: int = 1
    preset: str | None = None
    iterations: int | None = None
    points: int | None = None
    resolution: int | None = None
    only: str | None = None
    meshes: Path | None = None
    clouds: Path | None = None

    def command(self, name: str) -> str:
        """The command line; folders are left out, which differ from machine to machine."""
        flags: dict[str, Any] = {
            "--budget": self.budget,
            "--seeds": self.seeds if self.seeds > 1 else None,
            "--preset": self.preset,
            "--iterations": self.iterations,
            "--points": self.points,
            "--resolution": self.resolution,
            "--only": self.only,
            "--meshes": self.meshes and "DIR",
            "--clouds": self.clouds and "DIR",
        }
        given = [f"{flag}={value}" for flag, value in flags.items() if value is not None]
        quickly = ["--quick"] if self.quick else []
        return shlex.join(["mpf", "experiment", name, *quickly, *given])

    def options(self, own: dict[str, Any]) -> dict[str, Any]:
        """A trial's own options, above those of a quick run and below what is asked for."""
        made = ({**QUICK, **own} if self.quick else dict(own)) | self.size(own)
        if self.preset is not None:
            made["preset"] = self.preset
        if self.budget is not None:
            made["time_budget"] = self.budget
        if self.resolution is not None:
            made["resolution"] = self.resolution
        return made

    def size(self, own: dict[str, Any]) -> dict[str, Any]:
        """Iterations and points of a step, where asked for."""
        made: dict[str, Any] = {}
        if self.iterations is not None:
            made |= {"max_iterations": self.iterations, "time_budget": UNBOUND}
        if self.points is not None:
            made |= dict.fromkeys(SETS, self.points)
            if "paper" in (self.preset, own.get("preset")):  # its fourth set is as large
                made["laplacian_points"] = self.points
        return made
