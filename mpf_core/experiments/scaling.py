"""What a reconstruction costs as its cloud, its iterations and its resolution grow.

Each row is a process of its own: `mpf reconstruct` from file to files, and the peak of its memory.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpf_core.cloud.pointcloud import PointCloud
from mpf_core.errors import FitError
from mpf_core.experiments.asked import Asked
from mpf_core.experiments.trial import Outcome, Trial
from mpf_core.quality.meshio import read_mesh
from mpf_core.surface.export import cloud_ply_bytes

SHAPE = "holed-body"
POINTS = (1_000, 3_000, 10_000, 30_000, 100_000, 300_000, 1_000_000, 3_000_000)
ITERATIONS = (100, 200, 400, 800, 1600)
RESOLUTIONS = (64, 128, 256, 512, 1024)
MIDDLE = 30_000  # points where something else grows

# `mpf`, leaving behind the peak of its memory in KiB. Not the ru_maxrss that one can wait for: it
# starts at the size of the process that this one was forked from.
COMMAND = """
import atexit, re, sys
from pathlib import Path
from mpf_core.cli import main
peak = Path(sys.argv.pop(1))
status = Path("/proc/self/status")
atexit.register(lambda: peak.write_text(re.search(r"VmHWM:\\s+(\\d+)", status.read_text())[1]))
main()
"""


def trials(asked: Asked) -> list[Trial]:
    """One row after the other of points, iterations and resolutions, the rest held."""
    if asked.quick:
        small = {"width": 32, "max_iterations": 20, "resolution": 32}
        return [_trial(f"{n} points", n, small) for n in (500, 1000)]
    preset: dict[str, Any] = {"preset": asked.preset or "draft"}
    # At a fixed number of iterations, the clock of the preset must not cut the slow ones. After 400
    # the body is still hollow, with twice the area.
    long: dict[str, Any] = preset | {"max_iterations": 800, "time_budget": 3600.0}
    return [
        *(_trial(f"{n} points", n, preset) for n in POINTS),
        *(
            _trial(f"{n} iterations", MIDDLE, long | {"max_iterations": n, "patience": 0.0})
            for n in ITERATIONS
        ),
        *(_trial(f"{n} cells", MIDDLE, long | {"resolution": n}) for n in RESOLUTIONS),
    ]


def process(points: NDArray[np.float64], trial: Trial) -> Outcome:
    """`mpf reconstruct` in a process of its own, with the trial's options.

    Raises FitError with what the command said when it fails.
    """
    options = {"seed": trial.seed, **dict(trial.options)}
    with TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "cloud.ply").write_bytes(cloud_ply_bytes(PointCloud(points), []))
        flags = ["-o", str(folder / "mesh.ply"), "--report", str(folder / "report.json")]
        for option, value in options.items():
            flags += ["--set", f"{option}={json.dumps(value)}"]
        cost = command(["reconstruct", str(folder / "cloud.ply"), *flags], folder)
        report = json.loads((folder / "report.json").read_text())
        mesh = read_mesh(folder / "mesh.ply")
    facts = {name: report[name] for name in ("timings", "extraction", "fit", "surface")}
    facts["fit"].pop("history", None)
    figures = {
        "peak_mib": cost.peak,
        "processor_seconds": cost.busy,
        "iterations": report["fit"]["iterations"],
        "resolution": report["extraction"]["resolution"],
    }
    return Outcome(mesh, facts, seconds=cost.seconds, figures=figures)


@dataclass(frozen=True)
class Cost:
    """Of one process: `seconds` on the wall, `busy` of processors, `peak` of its memory in MiB."""

    seconds: float
    busy: float
    peak: float


def command(arguments: list[str], folder: Path) -> Cost:
    """`mpf` with these arguments, in a process of its own that leaves its notes in `folder`.

    Raises FitError with what the command said when it fails.
    """
    begin = time.perf_counter()
    with (folder / "said").open("wb") as said:
        child = subprocess.Popen(  # noqa: S603
            [sys.executable, "-c", COMMAND, str(folder / "peak"), *arguments],
            stdout=said,
            stderr=said,
        )
        _, status, usage = os.wait4(child.pid, 0)
    seconds = time.perf_counter() - begin
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode != 0:
        last = (folder / "said").read_text(errors="replace").strip().splitlines()[-1:]
        raise FitError(f"mpf {arguments[0]} failed: {''.join(last)}")
    peak = int((folder / "peak").read_text()) / 1024
    return Cost(seconds, usage.ru_utime + usage.ru_stime, peak)


def _trial(label: str, points: int, own: dict[str, Any]) -> Trial:
    return Trial(label, SHAPE, points, method="process", options=tuple(sorted(own.items())))
