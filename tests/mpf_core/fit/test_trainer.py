"""The loop on tiny fits: repeatable, stoppable, and honest when it diverges."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from mpf_core.cloud.neighbors import analyse
from mpf_core.errors import Cancelled, CheckpointError, Diverged, OutOfTime
from mpf_core.field import MetricPhaseField, pointwise
from mpf_core.fit import trainer as trainer_module
from mpf_core.fit.checkpoint import read_state
from mpf_core.fit.control import Control, FitLog, StepReport
from mpf_core.fit.initialize import initialize
from mpf_core.fit.sampler import Pools, warm_pools
from mpf_core.fit.schedule import Costs, Schedule
from mpf_core.fit.trainer import Trainer, fit_field, wants_normals
from mpf_core.fit_options import FitOptions
from mpf_core.heeding import heeding
from mpf_core.options import options_from
from mpf_core.parallel import workers
from tests.mpf_core.clouds import sphere

NEVER = 1e9
TINY: dict[str, Any] = {
    "width": 16,
    "surface_points": 32,
    "near_points": 32,
    "far_points": 32,
    "start_points": 64,
    "laplacian_points": 16,
    "max_iterations": 40,
}


@cache
def pools() -> Pools:
    cloud = analyse(sphere(300, 0.9), threads=1)
    start = initialize(cloud, threads=1)
    rng = np.random.default_rng(0)
    return warm_pools(cloud.points, cloud, start, FitOptions(), rng, size=3000)


def tiny(**changes: Any) -> FitOptions:
    return options_from(TINY | changes).fit


class Clock:
    """Tells `step` seconds more at every look."""

    def __init__(self, step: float = 0.0):
        self.now, self.step = 0.0, step

    def __call__(self) -> float:
        self.now += self.step
        return self.now


def fit(
    options: FitOptions, seed: int = 0, deadline: float = NEVER, **others: Any
) -> tuple[MetricPhaseField, FitLog]:
    reliability = others.pop("reliability", 1.0)
    control = Control(others.pop("clock", Clock()), deadline, **others)
    return fit_field(pools(), options, control, seed=seed, reliability=reliability)


def same(a: MetricPhaseField, b: MetricPhaseField) -> bool:
    return all(torch.equal(p, q) for p, q in zip(a.parameters(), b.parameters(), strict=True))


@pytest.fixture(autouse=True)
def _one_thread() -> Any:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.mark.parametrize("optimizer", ["adam", "muon"])
def test_a_seed_repeats_a_fit_bit_for_bit(optimizer: str) -> None:
    options = tiny(optimizer=optimizer)
    (one, log), (two, _), (other, _) = fit(options), fit(options), fit(options, seed=1)
    assert same(one, two)
    assert not same(one, other)
    assert (log.iterations, log.planned, log.stopped_by) == (40, 40, "iterations")


def test_a_fit_says_which_loops_it_ran_and_does_without_compiled_ones() -> None:
    _, log = fit(tiny())
    assert (log.loops, log.notes) == ("fused", [])
    with pointwise.uncompiled("there is no compiler"):
        (one, log), (two, _) = fit(tiny()), fit(tiny())
    assert same(one, two)
    assert log.loops == "plain"
    assert log.notes == ["Steps took longer, as loops could not be compiled: there is no compiler"]


def test_a_fit_lowers_its_loss_and_reports_every_twenty_steps() -> None:
    told: list[StepReport] = []
    _, log = fit(tiny(max_iterations=50, warm_start=False), report=told.append)
    assert [entry.iteration for entry in told] == [20, 40, 50]
    assert told == log.history
    assert all(entry.planned == 50 for entry in told)
    expected = {"zero", "align", "eik_r", "eik_phi", "lap", "phase", "far", "normal"}
    assert set(told[-1].losses) == expected
    assert told[-1].loss < told[0].loss


COSTS = Costs(regression=1.0, terms=2.0)


def test_the_plan_fits_the_time_at_the_pace_that_is_measured() -> None:
    schedule = Schedule(tiny(max_iterations=10_000), normals=True)
    # 0.48 of the regression alone, 0.12 of both, 0.4 of the terms: 0.48 + 0.12 · 3 + 0.4 · 2.
    assert schedule.planned(0, COSTS, 0.0, 1000.0) == int(0.98 * 1000 / 1.64)
    # Twice as slow as rehearsed: half as many.
    assert schedule.planned(100, COSTS, 200.0, 1000.0) == int(0.98 * 1000 / 3.28)
    assert schedule.planned(100, COSTS, 200.0, 1e9) == 10_000
    assert schedule.planned(0, COSTS, 0.0, 0.0) == 1


def test_nothing_depends_on_the_plan_while_it_may_change() -> None:
    schedule = Schedule(tiny(), normals=True)
    few, many = 400, 4000
    for iteration in range(schedule.first_phase(few)):
        assert schedule.rate(iteration, few) == schedule.rate(iteration, many)
        assert schedule.stage(iteration, few) == schedule.stage(iteration, many)


class Ticking(Clock):
    """A clock that the reports move on: 20 s each, 30 s where the paper's terms take part."""

    def tell(self, entry: StepReport) -> None:
        self.now += 30.0 if "zero" in entry.losses else 20.0


def test_a_run_that_the_clock_cut_is_repeated_by_its_number() -> None:
    clock = Ticking()
    cut, log = fit(tiny(max_iterations=4000), deadline=400.0, clock=clock, report=clock.tell)
    assert 100 <= log.planned <= 400
    again, repeated = fit(tiny(max_iterations=log.planned), stop=after(log.iterations))
    assert (repeated.planned, repeated.iterations) == (log.planned, log.iterations)
    assert same(cut, again)


def test_the_deadline_stops_a_fit_that_is_slower_than_planned() -> None:
    clock = Ticking()

    def later(entry: StepReport) -> None:
        clock.now += 0.0 if entry.iteration <= 100 else 100.0

    _, log = fit(tiny(max_iterations=200), deadline=150, clock=clock, report=later)
    assert (log.stopped_by, log.iterations, log.planned) == ("clock", 140, 200)


def test_too_little_time_for_a_surface_is_an_error() -> None:
    clock = Ticking()
    with pytest.raises(OutOfTime) as told:
        fit(tiny(max_iterations=400), deadline=30.0, clock=clock, report=clock.tell)
    assert told.value.code == "fit.out_of_time"
    with pytest.raises(OutOfTime):
        fit(tiny(max_iterations=400, warm_start=False), deadline=-1.0)


def test_the_rehearsal_leaves_no_trace() -> None:
    made = Trainer(pools(), tiny(), 0, FitLog())
    before = made.state()
    made._rehearsed(Clock())
    after = made.state()
    assert before.tensors.keys() == after.tensors.keys()
    assert all(torch.equal(before.tensors[name], after.tensors[name]) for name in before.tensors)
    assert all(p.grad is None for p in made.field.parameters())


def after(looks: int) -> Callable[[], bool]:
    """Says yes from the next look on after so many."""
    count = iter(range(10**9))
    return lambda: next(count) >= looks


def test_stop_ends_the_fit_with_what_there_is() -> None:
    field, log = fit(tiny(max_iterations=200), stop=after(70))
    assert (log.iterations, log.stopped_by) == (70, "cancel")
    assert isinstance(field, MetricPhaseField)


def test_stop_before_there_is_a_surface_ends_with_nothing() -> None:
    with pytest.raises(Cancelled):
        fit(tiny(max_iterations=200), stop=after(7))


def test_cancel_ends_the_fit_with_nothing() -> None:
    with pytest.raises(Cancelled) as told:
        fit(tiny(), cancel=after(7))
    assert told.value.where == "iteration 7"


class Broken(Trainer):
    """Loses a weight at iteration 120, so many times."""

    times = 1

    def step(self) -> Any:
        if self.iteration == 120 and self.log.retries < self.times:
            with torch.no_grad():
                self.field.siren.phase_output.fill_(float("nan"))
        return super().step()


def test_a_fit_that_diverges_goes_back_and_goes_on_at_lower_rates() -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trainer_module, "Trainer", Broken)
        _, log = fit(tiny(max_iterations=200))
    assert (log.retries, log.iterations, log.stopped_by) == (1, 200, "iterations")
    assert log.notes == ["diverged at iteration 140, went back to 120 at half the rates"]
    assert [entry.iteration for entry in log.history] == list(range(20, 201, 20))
    assert all(np.isfinite(entry.loss) for entry in log.history)


def test_a_fit_that_goes_on_diverging_is_an_error() -> None:
    class Hopeless(Broken):
        times = 10

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trainer_module, "Trainer", Hopeless)
        with pytest.raises(Diverged) as told:
            fit(tiny(max_iterations=200))
    assert told.value.advice is not None
    assert "learning_rate" in told.value.advice


def test_a_jump_of_the_loss_counts_as_divergence() -> None:
    made = Trainer(pools(), tiny(), 0, FitLog())
    made.log.history = [StepReport(k, 200, 0.0, 1.0, {"zero": 1.0}) for k in range(20, 120, 20)]
    assert made._diverged(StepReport(120, 200, 0.0, 21.0, {"zero": 1.0}))
    assert not made._diverged(StepReport(120, 200, 0.0, 19.0, {"zero": 1.0}))
    assert not made._diverged(StepReport(120, 200, 0.0, 21.0, {"zero": 1.0, "far": 1.0}))


def test_the_best_state_is_delivered_and_a_plateau_ends_the_fit() -> None:
    class Worsening(Trainer):
        def step(self) -> Any:
            done = super().step()
            if self.iteration > 340:
                with torch.no_grad():
                    self.field.siren.phase_offset.add_(0.01)
            return done

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trainer_module, "Trainer", Worsening)
        field, log = fit(tiny(max_iterations=500, patience=0.35))
        last, other = fit(tiny(max_iterations=500, patience=0.0))
    assert (log.kept, log.stopped_by) == (320, "plateau")
    assert log.iterations == 320 + 0.35 * 500 + 1
    assert (other.kept, other.stopped_by) == (500, "iterations")
    assert not same(field, last)


class Interrupted(Exception):
    pass


def interrupted(options: FitOptions, path: Path, at: int) -> None:
    """A fit that dies at an iteration, long after its last checkpoint was due."""
    clock = Clock(step=1.0)

    def die(entry: StepReport) -> None:
        if entry.iteration >= at:
            raise Interrupted

    with pytest.raises(Interrupted):
        fit(options, clock=clock, report=die, checkpoint=path)


@pytest.mark.parametrize("at", [60, 160])
def test_a_fit_goes_on_from_its_checkpoint_to_the_same_result(tmp_path: Path, at: int) -> None:
    options, path = tiny(max_iterations=200), tmp_path / "state"
    whole, log = fit(options)
    interrupted(options, path, at)
    resumed, after = fit(options, checkpoint=path)
    assert after.resumed_from is not None
    assert 0 < after.resumed_from <= at
    assert same(whole, resumed)
    assert [e.losses for e in after.history] == [e.losses for e in log.history]


@pytest.mark.parametrize("threads", [1, 2])
def test_a_cancelled_fit_keeps_its_state_between_two_steps(tmp_path: Path, threads: int) -> None:
    """Nothing within a step heeds the wish to stop: half a step cannot be gone on from."""
    wanted = False

    def report(entry: StepReport) -> None:
        nonlocal wanted
        wanted = entry.iteration >= 60

    def check() -> None:
        raise AssertionError("asked in the midst of a step")

    path = tmp_path / "state"
    with workers(threads), heeding(check), pytest.raises(Cancelled) as caught:
        fit(tiny(max_iterations=200), cancel=lambda: wanted, report=report, checkpoint=path)
    assert caught.value.where == "iteration 60"
    assert path.stat().st_size > 0


def test_a_fit_cancelled_while_it_is_looked_at_goes_on_to_the_same(tmp_path: Path) -> None:
    def snapshot(field: MetricPhaseField) -> None:
        nonlocal looks
        looks += 1
        if looks == 4:  # at iteration 80, where the state is judged as well
            raise Cancelled("cancelled while a preview was drawn", where="preview")

    looks, options, path = 0, tiny(max_iterations=120), tmp_path / "state"
    with pytest.raises(Cancelled):
        fit(options, snapshot=snapshot, checkpoint=path)
    resumed, log = fit(options, checkpoint=path)
    assert log.resumed_from == 80
    assert same(resumed, fit(options)[0])


@pytest.mark.parametrize("damage", ["cut", "other", "not one", "emptied"])
def test_a_checkpoint_that_cannot_be_used_is_told_and_left_out(tmp_path: Path, damage: str) -> None:
    options, path = tiny(max_iterations=120), tmp_path / "state"
    interrupted(options, path, 60)
    content = path.read_bytes()
    broken = {"cut": content[:-100], "not one": b"mesh" * 100, "emptied": b""}
    if damage == "other":
        interrupted(tiny(max_iterations=120, omega=20.0), path, 60)
    else:
        path.write_bytes(broken[damage])
    with pytest.raises(CheckpointError):
        read_state(path, "of this fit")
    field, log = fit(options, checkpoint=path)
    assert log.resumed_from is None
    assert "began anew" in log.notes[0]
    assert same(field, fit(options)[0])


def test_the_regression_has_no_weight_over_the_last_forty_percent() -> None:
    made = Trainer(pools(), tiny(), 0, FitLog())
    weights = [made.schedule.stage(done, 1000).regression for done in range(1000)]
    assert weights[0] == 1
    assert all(a >= b for a, b in pairwise(weights))
    assert {w for done, w in enumerate(weights) if done >= 600} == {0.0}
    assert "regression" not in made.objective.terms(made.schedule.stage(600, 1000))
    assert "regression" in made.objective.terms(made.schedule.stage(0, 1000))


def test_options_cannot_ask_for_a_longer_regression() -> None:
    assert FitOptions.__dataclass_fields__["warm_fraction"].metadata["high"] == 0.6


def test_without_a_warm_start_the_papers_terms_run_from_the_first_step() -> None:
    made = Trainer(pools(), tiny(warm_start=False), 0, FitLog())
    first = made.schedule.stage(0, 1000)
    assert (first.terms, first.regression) == (True, 0.0)
    assert "regression" not in made.objective.terms(first)


def test_align_is_switched_on_late() -> None:
    made = Trainer(pools(), tiny(align_from=0.7), 0, FitLog())
    at = (0, 500, 690, 700, 990)
    assert [made.schedule.stage(iteration, 1000).align for iteration in at] == [
        False, False, False, True, True,
    ]  # fmt: skip
    assert "align" not in made.objective.terms(made.schedule.stage(650, 1000))
    assert "align" in made.objective.terms(made.schedule.stage(700, 1000))


@pytest.mark.parametrize(
    ("normals", "reliability", "on"),
    [("auto", 0.95, True), ("auto", 0.3, False), ("on", 0.0, True), ("off", 1.0, False)],
)
def test_normals_are_on_when_reliable_or_forced(normals: str, reliability: float, on: bool) -> None:
    options = tiny(normals=normals, max_iterations=1, warm_start=False)
    assert wants_normals(options, reliability) is on
    _, log = fit(options, reliability=reliability)
    assert log.normal_term is on
    assert ("normal" in log.history[-1].losses) is on
