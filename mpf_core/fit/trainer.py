"""The loop: caps, stop rules, roll-back, checkpoints, progress, cancel.

The only state of a fit lives here. `schedule` says what each step consists of, `checkpoint` keeps
the state, `fit_field` is what callers use.
"""

from __future__ import annotations

import math
from dataclasses import asdict, replace
from pathlib import Path
from statistics import median

import numpy as np
import torch
from torch import Tensor

from mpf_core.errors import Cancelled, CheckpointError, Diverged, OutOfTime
from mpf_core.field import MetricPhaseField
from mpf_core.field.pointwise import why_plain
from mpf_core.field.precision import products_in
from mpf_core.field.sweeps import forget_buffers
from mpf_core.fit.averaging import Averaging
from mpf_core.fit.batch import Stage
from mpf_core.fit.checkpoint import State, fingerprint, read_state, write_state
from mpf_core.fit.compiled import prepare
from mpf_core.fit.control import Control, FitLog, StepReport
from mpf_core.fit.objective import Objective
from mpf_core.fit.optimizers import Optimizer
from mpf_core.fit.sampler import Pools
from mpf_core.fit.schedule import Costs, Schedule
from mpf_core.fit_options import FitOptions
from mpf_core.heeding import heeding
from mpf_core.parallel import flushed_denormals
from mpf_core.progress import Clock

RELIABLE_NORMALS = 0.8  # share of agreeing PCA normals from which the normal term is on
REPORT_EVERY = 20  # iterations between two progress reports
JUDGE_EVERY = 40  # iterations between two looks at how good the state is; kept to go back to
LEAST_PATIENCE = 4 * JUDGE_EVERY  # iterations without a better state, however short the fit
JUMP = 20.0  # times the recent loss: a fit beyond it has diverged
RETRIES = 3  # at half the rates each, from the last good state
REHEARSALS = 6  # steps of each kind that are timed; the fastest counts
FEWEST = 50  # iterations: with less the field is not yet a surface
# ω₀ at the spacing of 10,000 samples of a sheet and from there on, and the highest one.
OMEGA, SPARSE, HIGHEST_OMEGA = 45.0, 0.0285, 85.0
KEEP_EVERY = 15.0  # seconds between two checkpoints on disk


def wants_normals(options: FitOptions, reliability: float) -> bool:
    """Whether the normal term is on: as forced, or when PCA normals are reliable."""
    if options.normals == "auto":
        return reliability >= RELIABLE_NORMALS
    return options.normals == "on"


def first_frequency(options: FitOptions, spacing: float) -> float:
    """ω₀ for a cloud with that spacing: as forced, or the higher the closer the samples are."""
    if options.omega is not None:
        return options.omega
    return float(np.clip(OMEGA * SPARSE / spacing, OMEGA, HIGHEST_OMEGA))


def fit_field(
    pools: Pools,
    options: FitOptions,
    control: Control,
    *,
    seed: int,
    reliability: float,
    threads: int = 1,
) -> tuple[MetricPhaseField, FitLog]:
    """Fit a field to the pools until the iteration cap, a plateau, the deadline, or `stop`.

    Raises Cancelled when `cancel` says so, or `stop` before there is a surface; OutOfTime when
    the deadline leaves too few iterations for one; Diverged when lower rates do not help.
    """
    log = FitLog(normal_term=wants_normals(options, reliability))
    log.loops = prepare(products_in(options.precision), control.cancel).NAME
    if log.loops == "plain":
        log.notes.append(f"Steps took longer, as loops could not be compiled: {why_plain()}")
    trainer = Trainer(pools, options, seed, log)
    if control.checkpoint is not None:
        trainer.name = fingerprint(pools, options, seed, threads)
    try:
        # Cancelling ends a fit between two steps, where its state is whole and can be kept.
        with heeding(lambda: None):
            trainer.run(control)
    finally:
        forget_buffers()
    return trainer.field, log


class Trainer:
    """A fit under way."""

    def __init__(self, pools: Pools, options: FitOptions, seed: int, log: FitLog):
        self.options, self.log, self.name = options, log, ""
        self.generator = torch.Generator().manual_seed(seed)
        self.field = MetricPhaseField(
            width=options.width,
            omega=first_frequency(options, pools.spacing),
            slow=options.slow_waves,
            beta=options.beta,
            softplus_slope=options.softplus_slope,
            closed=options.closed,
            composite=options.composite,
            generator=self.generator,
        )
        precision = products_in(options.precision)
        self.field.siren.precision = precision
        log.omega = self.field.omega
        log.precision = str(precision).removeprefix("torch.")
        self.objective = Objective(self.field, pools, options, self.generator)
        self.optimizer = Optimizer(self.field, options, precision)
        self.schedule = Schedule(options, log.normal_term)
        self.examination = self.objective.examination(seed)
        self.iteration, self.planned, self.settled = 0, options.max_iterations, False
        self.slowdown, self.seconds_before, self.points = 1.0, 0.0, 0
        self.best: tuple[float, int, dict[str, Tensor]] | None = None
        self.averaging = Averaging(self.field, options.averaging)

    def run(self, control: Control) -> None:
        """Step until something ends the fit; leaves the best mean of states in `field`."""
        self._resume(control.checkpoint)
        begin = control.clock()
        try:
            ended = self._stepped(control, begin)
        except Cancelled:  # perhaps to go on elsewhere
            self._keep(control, begin)
            raise
        self._finish(ended, control.clock() - begin)

    def _stepped(self, control: Control, begin: float) -> str:
        """Step until something ends the fit, and what; Cancelled comes between two steps."""
        costs = self._rehearsed(control.clock)
        good, kept_at = self.state(), begin
        while True:
            now = control.clock()
            self._plan(costs, now - begin, control.deadline - begin)
            ended = self._ended(control, now)
            if ended is not None:
                return ended
            terms, stage = self.step()
            if self.iteration % REPORT_EVERY == 0 or self.iteration == self.planned:
                entry = self._entry(control.clock() - begin, terms, stage)
                if self._diverged(entry):
                    self._go_back(good)
                    continue
                self.log.history.append(entry)
                if self.iteration % JUDGE_EVERY == 0 or self.iteration == self.planned:
                    good = self.state()
                    self._judge()
                self._tell(entry, control)
            if control.clock() - kept_at > KEEP_EVERY:
                self._keep(control, begin)
                kept_at = control.clock()

    def step(self) -> tuple[dict[str, Tensor], Stage]:
        """One iteration; returns the unweighted terms."""
        stage = self.schedule.stage(self.iteration, self.planned)
        rate = self.slowdown * self.schedule.rate(self.iteration, self.planned)
        with flushed_denormals():
            self.optimizer.zero_grad()
            terms = self.objective.backward(stage)
            self.optimizer.step(rate)
        self.iteration += 1
        if self.options.averaging and self._alone:
            self.averaging.add()
        self.points += self.objective.points(stage)
        return terms, stage

    def state(self) -> State:
        """All that the next step depends on, copied."""
        tensors = {f"field.{k}": v.clone() for k, v in self.field.state_dict().items()}
        tensors |= {f"optimizer.{k}": v for k, v in self.optimizer.state().items()}
        tensors["generator"] = self.generator.get_state()
        if self.best is not None:
            tensors |= {f"best.{k}": v for k, v in self.best[2].items()}
        tensors |= {f"mean.{k}": v.clone() for k, v in self.averaging.mean.items()}
        facts = {
            "iteration": self.iteration,
            "planned": self.planned,
            "settled": self.settled,
            "slowdown": self.slowdown,
            "retries": self.log.retries,
            "seconds": self.seconds_before,
            "averaged": self.averaging.steps,
            "best": None if self.best is None else self.best[:2],
        }
        return State(tensors, facts, [asdict(entry) for entry in self.log.history])

    def restore(self, state: State) -> None:
        """Go back, or on, to a state of the same fit."""

        def part(name: str) -> dict[str, Tensor]:
            lead = f"{name}."
            return {k.removeprefix(lead): v for k, v in state.tensors.items() if k.startswith(lead)}

        facts = state.facts
        self.field.load_state_dict(part("field"))
        self.optimizer.restore(part("optimizer"))
        self.generator.set_state(state.tensors["generator"])
        self.iteration, self.planned = facts["iteration"], facts["planned"]
        self.settled, self.slowdown = facts["settled"], facts["slowdown"]
        self.log.retries, self.seconds_before = facts["retries"], facts["seconds"]
        self.best = None if facts["best"] is None else (*facts["best"], part("best"))
        self.averaging.restore(part("mean"), facts["averaged"])
        self.log.history = [StepReport(**entry) for entry in state.history]

    def _plan(self, costs: Costs, elapsed: float, available: float) -> None:
        """Settle the number of iterations, before anything depends on it."""
        if self.settled:
            return
        schedule = self.schedule
        done = self.seconds_before + elapsed
        if schedule.alone:
            self.planned = schedule.planned(
                self.iteration, costs, done, self.seconds_before + available
            )
        if self.iteration < schedule.first_phase(self.planned):
            return
        if self.iteration != schedule.first_phase(self.planned):
            # The pace has fallen: what there is becomes the first phase of a shorter fit.
            self.planned = round(self.iteration / schedule.alone)
        self.settled = True
        if self.planned < min(FEWEST, self.options.max_iterations):
            raise self._out_of_time()

    def _ended(self, control: Control, now: float) -> str | None:
        if control.cancel is not None and control.cancel():
            raise Cancelled("the fit was cancelled", where=f"iteration {self.iteration}")
        if control.stop is not None and control.stop():
            if self.iteration < min(FEWEST, self.options.max_iterations):
                raise Cancelled(
                    "the fit was stopped before there was a surface",
                    where=f"iteration {self.iteration}",
                )
            return "cancel"
        if self.settled and self.iteration >= self.planned:
            return "iterations"
        if now >= control.deadline:
            if self.iteration < min(FEWEST, self.options.max_iterations):
                raise self._out_of_time()
            return "clock"
        patience = max(self.options.patience * self.planned, LEAST_PATIENCE)
        if self.best is not None and self.iteration - self.best[1] > patience:
            return "plateau"
        return None

    def _out_of_time(self) -> OutOfTime:
        return OutOfTime(
            "the time budget leaves too few iterations for a surface",
            where=f"{self.iteration} of at least {FEWEST}",
            advice="Raise time_budget, or run fewer things at the same time.",
        )

    def _rehearsed(self, clock: Clock) -> Costs:
        """Seconds of both kinds of steps, without a trace."""
        if self.settled or not self.schedule.alone:
            return Costs(1.0, 1.0)
        before = self.generator.get_state()
        alone = Stage(False, False, False, 1.0)
        costs = [math.inf, math.inf]
        # In turn, since the first steps of a process are slow whatever their kind.
        for _ in range(REHEARSALS):
            for kind, stage in enumerate((alone, Stage(True, True, self.log.normal_term, 0.0))):
                begin = clock()
                self.objective.backward(stage)
                self.optimizer.rehearse()
                costs[kind] = min(costs[kind], max(clock() - begin, 1e-9))
        self.optimizer.zero_grad()
        self.generator.set_state(before)
        return Costs(*costs)

    def _entry(self, seconds: float, terms: dict[str, Tensor], stage: Stage) -> StepReport:
        with torch.no_grad():
            loss = float(self.objective.total(terms, stage))
        values = {name: float(term.detach()) for name, term in terms.items()}
        seconds += self.seconds_before
        return StepReport(self.iteration, self.planned, seconds, loss, values, self.points)

    def _diverged(self, entry: StepReport) -> bool:
        """Not finite, or far above what the same terms came to lately."""
        if not math.isfinite(entry.loss):
            return True
        alike = [e.loss for e in self.log.history[-10:] if e.losses.keys() == entry.losses.keys()]
        return len(alike) >= 5 and entry.loss > JUMP * median(alike)

    def _go_back(self, good: State) -> None:
        """From the last good state, at half the rates."""
        retries, slowdown = self.log.retries + 1, self.slowdown / 2
        if retries > RETRIES:
            raise Diverged(
                "the fit diverged",
                where=f"iteration {self.iteration}",
                advice="Lower learning_rate and muon_learning_rate, or use another seed.",
            )
        note = f"diverged at iteration {self.iteration}, went back to {good.facts['iteration']}"
        self.log.notes.append(f"{note} at half the rates")
        planned, settled = self.planned, self.settled
        self.restore(good)
        self.log.retries, self.slowdown = retries, slowdown
        self.planned, self.settled = planned, settled

    def _tell(self, entry: StepReport, control: Control) -> None:
        if control.report is not None:
            control.report(entry)
        if control.snapshot is not None:
            control.snapshot(self.field)

    def _judge(self) -> None:
        """Keep the state if it is the best since the paper's terms stand alone."""
        if not self.options.patience or not self._alone:
            return
        with self.averaging.shown() as state:
            value = self.objective.examined(self.examination)
            if self.best is None or value < self.best[0]:
                copied = {k: v.clone() for k, v in state.items()}
                self.best = value, self.iteration, copied

    @property
    def _alone(self) -> bool:
        """Whether the paper's terms stand alone."""
        return self.iteration >= self.options.warm_fraction * self.planned

    def _resume(self, path: Path | None) -> None:
        if path is None:
            return
        try:
            state = read_state(path, self.name)
        except CheckpointError as error:
            self.log.notes.append(f"{error} The fit began anew.")
            return
        if state is not None:
            self.restore(state)
            self.log.resumed_from = self.iteration

    def _keep(self, control: Control, begin: float) -> None:
        if control.checkpoint is None:
            return
        state = self.state()
        seconds = self.seconds_before + control.clock() - begin
        state = replace(state, facts={**state.facts, "seconds": seconds})
        try:
            write_state(control.checkpoint, state, self.name)
        except OSError as error:
            self.log.notes.append(f"iteration {self.iteration} could not be kept: {error.strerror}")

    def _finish(self, ended: str, seconds: float) -> None:
        log = self.log
        log.planned, log.iterations = self.planned, self.iteration
        log.seconds, log.stopped_by = self.seconds_before + seconds, ended
        log.kept = self.iteration
        if self.best is not None:
            self.field.load_state_dict(self.best[2])
            log.kept = self.best[1]
        elif self.averaging.mean:
            self.field.load_state_dict(self.averaging.mean)
