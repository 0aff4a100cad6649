"""When each term is on, how large the steps are, and how many there will be.

With a warm start the regression runs alone at first, at full rates; how many steps that are, N·s
of N, is decided while it runs, by the clock where that binds. Until then nothing depends on N, so
a run that the clock cut to N iterations is the run with a cap of N. Then the paper's terms join,
the regression fades out, and the rates fall from `terms_rate` on.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from mpf_core.fit.batch import Stage
from mpf_core.fit_options import FitOptions

REGRESSION_ALONE = 0.8  # share of the warm start before the paper's terms join
RAMP = 20  # steps in which the rates rise from 1/20 at the very start
LAST_RATE = 0.02  # of the first
RESERVE = 0.98  # of the time left is planned for; the rest is for steps slower than measured


@dataclass(frozen=True)
class Costs:
    """Seconds of a step of the regression alone, and of the paper's terms."""

    regression: float
    terms: float


@dataclass(frozen=True)
class Schedule:
    """The course of one fit; `normals` says whether the normal term takes part."""

    options: FitOptions
    normals: bool

    @property
    def alone(self) -> float:
        """Share of all iterations in which the regression runs alone."""
        return self.options.warm_fraction * REGRESSION_ALONE if self.options.warm_start else 0.0

    def first_phase(self, planned: int) -> int:
        """Iterations of the regression alone, of so many."""
        return round(self.alone * planned)

    def planned(self, iteration: int, costs: Costs, elapsed: float, available: float) -> int:
        """How many iterations the fit can have, at `iteration` of the regression alone.

        costs: measured beforehand, for their ratio; elapsed: seconds of the fit so far, which
        give the machine's pace; available: seconds from the fit's first step to its deadline.
        """
        pace = max(elapsed / iteration, 1e-9) if iteration else costs.regression
        later = pace * costs.terms / costs.regression
        faded = self.options.warm_fraction - self.alone
        whole = self.alone * pace + faded * pace + (1 - self.alone) * later  # of one iteration
        return max(1, min(self.options.max_iterations, int(RESERVE * available / whole)))

    def stage(self, iteration: int, planned: int) -> Stage:
        """Which terms are on at an iteration of so many."""
        options = self.options
        done = iteration / planned
        align = done >= options.align_from
        if not options.warm_start or done >= options.warm_fraction:
            return Stage(True, align, self.normals, 0.0)
        if iteration < self.first_phase(planned):
            return Stage(False, False, False, 1.0)
        # Faded, not cut: a step in the objective throws the optimisers' momenta off.
        fading = (done - self.alone) / (options.warm_fraction - self.alone)
        return Stage(True, align, self.normals, 0.5 * (1 + math.cos(math.pi * max(fading, 0.0))))

    def rate(self, iteration: int, planned: int) -> float:
        """Factor on the learning rates."""
        if self.options.schedule == "constant":
            return 1.0
        held = self.first_phase(planned)
        if iteration < held:
            return min(1.0, (iteration + 1) / RAMP)
        done = (iteration - held) / max(planned - held, 1)
        first = self.options.terms_rate if held else 1.0
        fallen = max(first * 0.5 * (1 + math.cos(math.pi * done)), LAST_RATE)
        return fallen * min(1.0, (iteration + 1) / RAMP)
