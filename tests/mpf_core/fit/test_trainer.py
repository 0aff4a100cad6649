"""The loop on tiny fits: repeatable, stoppable, and honest when it diverges."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import torch

from mpf_core.cloud.neighbors import analyse
from mpf_core.errors import Cancelled, Diverged
from mpf_core.field import MetricPhaseField
from mpf_core.fit import trainer as trainer_module
from mpf_core.fit.initialize import initialize
from mpf_core.fit.sampler import Pools, warm_pools
from mpf_core.fit.trainer import REHEARSALS, FitLog, StepReport, Trainer, fit_field, wants_normals
from mpf_core.options import FitOptions, options_from
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
    return warm_pools(cloud.points, cloud, start, np.random.default_rng(0), size=3000)


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
    settings: dict[str, Any] = {"reliability": 1.0, "clock": Clock()} | others
    return fit_field(pools(), options, seed=seed, deadline=deadline, **settings)


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


def test_a_fit_lowers_its_loss_and_reports_every_twenty_steps() -> None:
    told: list[StepReport] = []
    _, log = fit(tiny(max_iterations=50, warm_start=False), report=told.append)
    assert [entry.iteration for entry in told] == [20, 40, 50]
    assert told == log.history
    assert all(entry.planned == 50 for entry in told)
    expected = {"zero", "align", "eik_r", "eik_phi", "lap", "phase", "far", "normal"}
    assert set(told[-1].losses) == expected
    assert told[-1].loss < told[0].loss


def test_the_plan_fits_the_deadline() -> None:
    # One second a look, so a rehearsed step seems to take 1/REHEARSALS seconds.
    options = tiny(max_iterations=10_000)
    made = Trainer(pools(), options, 0, FitLog())
    planned = made.plan(Clock(1.0), deadline=10.0)
    assert planned == int(0.97 * (10.0 - 3.0) * REHEARSALS)
    assert Trainer(pools(), options, 0, FitLog()).plan(Clock(1.0), deadline=0.0) == 1


def test_the_deadline_stops_a_fit_that_is_slower_than_rehearsed() -> None:
    clock = Clock()

    class Slow(list[StepReport]):
        def append(self, entry: StepReport) -> None:
            clock.now += 100
            super().append(entry)

    told = Slow()
    _, log = fit(tiny(max_iterations=200), deadline=150, clock=clock, report=told.append)
    assert log.stopped_by == "clock"
    assert log.iterations == 40
    assert log.planned == 200


def test_the_rehearsal_leaves_the_weights_alone() -> None:
    made = Trainer(pools(), tiny(), 0, FitLog())
    before = [p.detach().clone() for p in made.field.parameters()]
    made.plan(Clock(), NEVER)
    assert all(torch.equal(p, q) for p, q in zip(before, made.field.parameters(), strict=True))
    assert all(p.grad is None for p in made.field.parameters())


def after(looks: int) -> Callable[[], bool]:
    """Says yes from the next look on after so many."""
    count = iter(range(10**9))
    return lambda: next(count) >= looks


def test_stop_ends_the_fit_with_what_there_is() -> None:
    field, log = fit(tiny(), stop=after(7))
    assert (log.iterations, log.stopped_by) == (7, "cancel")
    assert isinstance(field, MetricPhaseField)


def test_cancel_ends_the_fit_with_nothing() -> None:
    with pytest.raises(Cancelled) as told:
        fit(tiny(), cancel=after(7))
    assert told.value.where == "iteration 7"


def test_divergence_is_noticed_retried_and_told() -> None:
    options = tiny(optimizer="adam", learning_rate=1.0, schedule="constant", beta_learning_rate=1.0)
    slowdowns = []

    class Watched(Trainer):
        def __init__(self, *args: Any, slowdown: float = 1.0):
            super().__init__(*args, slowdown=slowdown)
            slowdowns.append(slowdown)
            # Rates bounded by the options do not overflow so small a network; a weight does.
            with torch.no_grad():
                self.field.siren.phase_output.fill_(float("inf"))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trainer_module, "Trainer", Watched)
        with pytest.raises(Diverged) as told:
            fit(options)
    assert slowdowns == [1, 0.5, 0.25, 0.125]
    assert told.value.advice
    assert "learning_rate" in told.value.advice


def test_a_retry_at_half_rate_that_holds_is_counted() -> None:
    class FirstFails(Trainer):
        def __init__(self, *args: Any, slowdown: float = 1.0):
            super().__init__(*args, slowdown=slowdown)
            if slowdown == 1:
                with torch.no_grad():
                    self.field.siren.phase_output.fill_(float("nan"))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trainer_module, "Trainer", FirstFails)
        _, log = fit(tiny())
    assert log.retries == 1
    assert log.stopped_by == "iterations"
    assert all(np.isfinite(entry.loss) for entry in log.history)


def test_the_regression_has_no_weight_over_the_last_forty_percent() -> None:
    made = Trainer(pools(), tiny(), 0, FitLog())
    weights = [made.stage(done / 1000).regression for done in range(1000)]
    assert weights[0] == 1
    assert all(a >= b for a, b in pairwise(weights))
    assert {w for done, w in enumerate(weights) if done >= 600} == {0.0}
    assert "regression" not in made.objective.terms(made.stage(0.6))
    assert "regression" in made.objective.terms(made.stage(0.0))


def test_options_cannot_ask_for_a_longer_regression() -> None:
    assert FitOptions.__dataclass_fields__["warm_fraction"].metadata["high"] == 0.6


def test_without_a_warm_start_the_papers_terms_run_from_the_first_step() -> None:
    made = Trainer(pools(), tiny(warm_start=False), 0, FitLog())
    first = made.stage(0.0)
    assert (first.terms, first.regression) == (True, 0.0)
    assert "regression" not in made.objective.terms(first)


def test_align_is_switched_on_late() -> None:
    made = Trainer(pools(), tiny(align_from=0.7), 0, FitLog())
    assert [made.stage(done).align for done in (0.0, 0.5, 0.69, 0.7, 0.99)] == [
        False, False, False, True, True,
    ]  # fmt: skip
    assert "align" not in made.objective.terms(made.stage(0.65))
    assert "align" in made.objective.terms(made.stage(0.7))


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
