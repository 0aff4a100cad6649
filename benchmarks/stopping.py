"""How soon a reconstruction ends once it is cancelled, whatever it is at.

    python benchmarks/stopping.py [--points 3000000] [--iterations 60] [--after 1 3 9 …]

Each time the same cloud is begun anew with `draft` and cancelled so many seconds after that.
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np
from numpy.typing import NDArray

from mpf_core.errors import Cancelled
from mpf_core.experiments.shapes import sample
from mpf_core.options import options_from
from mpf_core.pipeline import reconstruct
from mpf_core.progress import Progress

SHAPE = "holed-body"


def stopped(points: NDArray[np.float64], iterations: int, after: float) -> tuple[str, float]:
    """The stage in which a run was cancelled, and the seconds that it still went on."""
    options = options_from({"preset": "draft", "max_iterations": iterations})
    stage, begin = "", time.monotonic()

    def hear(progress: Progress) -> None:
        nonlocal stage
        stage = progress.stage

    try:
        reconstruct(points, options, progress=hear, cancel=lambda: time.monotonic() - begin > after)
    except Cancelled:
        return stage, time.monotonic() - begin - after
    return "done", 0.0


def main() -> None:
    """Prints a row for each time."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--points", type=int, default=3_000_000)
    parser.add_argument("--iterations", type=int, default=60)
    parser.add_argument("--after", type=float, nargs="+", default=[0.3, 1, 3, 6, 9, 12, 15, 20])
    chosen = parser.parse_args()
    points = sample(SHAPE, chosen.points, 0)
    sys.stdout.write("| points | cancelled after, s | in | still went on, s |\n")
    sys.stdout.write("| ---: | ---: | --- | ---: |\n")
    for after in chosen.after:
        stage, late = stopped(points, chosen.iterations, after)
        sys.stdout.write(f"| {chosen.points} | {after:g} | {stage} | {late:.2f} |\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
