"""The loop: schedule, caps, stop rules, progress, cancel. The only state of a fit lives here."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import torch
from torch import Tensor

from mpf_core.errors import Cancelled, Diverged
from mpf_core.field import MetricPhaseField
from mpf_core.fit.objective import Objective, Stage
from mpf_core.fit.optimizers import Optimizer
from mpf_core.fit.sampler import Pools
from mpf_core.options import FitOptions
from mpf_core.progress import CancelCheck

RELIABLE_NORMALS = 0.8  # share of agreeing PCA normals from which the normal term is on
REPORT_EVERY = 20  # iterations between two progress reports
REGRESSION_ALONE = 0.8  # share of the warm start before the paper's terms join
RETRIES = 3  # at half the rates each, after the loss stopped being finite
REHEARSALS = 5  # steps, spread over the fit, that are timed before the schedule is laid out
RESERVE = 0.97  # of the time left is planned for; the rest is for steps slower than rehearsed

Clock = Callable[[], float]


@dataclass(frozen=True)
class StepReport:
    """Where the fit stands after one iteration; `losses` are the unweighted terms."""

    iteration: int
    planned: int
    seconds: float
    loss: float
    losses: dict[str, float]


@dataclass
class FitLog:
    """What the fit did, for the report.

    `planned` is the number of iterations that the schedule was laid out for; `stopped_by` one of
    "iterations", "clock", "cancel" (the caller's `stop`). A run with `--max-iterations planned`
    and a time budget that does not bind repeats it.
    """

    planned: int = 0
    iterations: int = 0
    seconds: float = 0.0
    stopped_by: str = "iterations"
    normal_term: bool = False
    retries: int = 0
    history: list[StepReport] = field(default_factory=list)


def wants_normals(options: FitOptions, reliability: float) -> bool:
    """Whether the normal term is on: as forced, or when PCA normals are reliable."""
    if options.normals == "auto":
        return reliability >= RELIABLE_NORMALS
    return options.normals == "on"


def fit_field(
    pools: Pools,
    options: FitOptions,
    *,
    seed: int,
    reliability: float,
    clock: Clock,
    deadline: float,
    report: Callable[[StepReport], None] | None = None,
    stop: CancelCheck | None = None,
    cancel: CancelCheck | None = None,
) -> tuple[MetricPhaseField, FitLog]:
    """Fit a field to the pools until the iteration cap, the `deadline` of `clock`, or `stop`.

    A stopped fit returns what it has. Raises Cancelled when `cancel` says so, and Diverged when
    retries at lower rates do not help.
    """
    log = FitLog(normal_term=wants_normals(options, reliability))
    for attempt in range(RETRIES + 1):
        trainer = Trainer(pools, options, seed, log, slowdown=0.5**attempt)
        if trainer.run(clock, deadline, report, stop, cancel):
            return trainer.field, log
        log.retries += 1
    raise Diverged(
        "the fit diverged",
        where=f"iteration {log.iterations}",
        advice="Lower learning_rate and muon_learning_rate, or use another seed.",
    )


class Trainer:
    """One attempt at a fit."""

    def __init__(
        self, pools: Pools, options: FitOptions, seed: int, log: FitLog, slowdown: float = 1.0
    ):
        self.options, self.log = options, log
        self.generator = torch.Generator().manual_seed(seed)
        self.field = MetricPhaseField(
            width=options.width,
            omega=options.omega,
            beta=options.beta,
            softplus_slope=options.softplus_slope,
            closed=options.closed,
            generator=self.generator,
        )
        self.objective = Objective(self.field, pools, options, self.generator)
        self.optimizer = Optimizer(self.field, options, slowdown)

    def run(
        self,
        clock: Clock,
        deadline: float,
        report: Callable[[StepReport], None] | None,
        stop: CancelCheck | None,
        cancel: CancelCheck | None,
    ) -> bool:
        """True when the fit ended as planned, by the clock or by `stop`; False on divergence."""
        begin = clock()
        planned = self.plan(clock, deadline)
        iteration = 0
        stopped_by = "iterations"
        while iteration < planned:
            if cancel is not None and cancel():
                raise Cancelled("the fit was cancelled", where=f"iteration {iteration}")
            if stop is not None and stop():
                stopped_by = "cancel"
                break
            if clock() >= deadline:
                stopped_by = "clock"
                break
            done = iteration / planned
            stage = self.stage(done)
            terms = self.step(stage, done, iteration)
            iteration += 1
            if iteration % REPORT_EVERY == 0 or iteration == planned:
                entry = self._entry(iteration, planned, clock() - begin, terms, stage)
                if not math.isfinite(entry.loss):
                    return False
                self.log.history.append(entry)
                if report is not None:
                    report(entry)
        self.log.planned, self.log.iterations = planned, iteration
        self.log.seconds, self.log.stopped_by = clock() - begin, stopped_by
        return True

    def stage(self, done: float) -> Stage:
        """Which terms are on at the share `done` of the fit."""
        options = self.options
        if not options.warm_start or done >= options.warm_fraction:
            return Stage(True, done >= options.align_from, self.log.normal_term, 0.0)
        alone = options.warm_fraction * REGRESSION_ALONE
        if done < alone:
            return Stage(False, False, False, 1.0)
        # Faded, not cut: a step in the objective throws the optimisers' momenta off.
        fade = 0.5 * (1 + math.cos(math.pi * (done - alone) / (options.warm_fraction - alone)))
        return Stage(True, done >= options.align_from, self.log.normal_term, fade)

    def step(self, stage: Stage, done: float, iteration: int) -> dict[str, Tensor]:
        """One iteration; returns the unweighted terms."""
        self.optimizer.zero_grad()
        terms = self.objective.terms(stage)
        self.objective.total(terms, stage).backward()  # type: ignore[no-untyped-call]
        self.optimizer.step(done, iteration)
        return terms

    def plan(self, clock: Clock, deadline: float) -> int:
        """As many iterations as fit before the deadline, at most the cap.

        The schedule is laid out once, from steps rehearsed at moments spread over the fit, so that
        a run depends on the clock through one number only.
        """
        moments = [(i + 0.5) / REHEARSALS for i in range(REHEARSALS)]
        for done in moments:  # the first steps allocate; they are slower and not timed
            self.rehearse(done)
        begin = clock()
        for done in moments:
            self.rehearse(done)
        per_step = max((clock() - begin) / REHEARSALS, 1e-9)
        affordable = int(RESERVE * (deadline - clock()) / per_step)
        return max(1, min(self.options.max_iterations, affordable))

    def rehearse(self, done: float) -> None:
        """A step whose gradients are not applied."""
        stage = self.stage(done)
        self.objective.total(self.objective.terms(stage), stage).backward()  # type: ignore[no-untyped-call]
        self.optimizer.zero_grad()

    def _entry(
        self, iteration: int, planned: int, seconds: float, terms: dict[str, Tensor], stage: Stage
    ) -> StepReport:
        with torch.no_grad():
            loss = float(self.objective.total(terms, stage))
        values = {name: float(term.detach()) for name, term in terms.items()}
        return StepReport(iteration, planned, seconds, loss, values)
