"""The simulation of queues against what theory knows."""

from __future__ import annotations

import random

import pytest

from benchmarks.queueing import Arrival, Kind, Pool, arrivals, simulate


def poisson(rate: float, count: int, seed: int = 0) -> list[float]:
    chance = random.Random(seed)  # noqa: S311
    now = 0.0
    return [now := now + chance.expovariate(rate) for _ in range(count)]


@pytest.mark.parametrize("load", [0.5, 0.8])
def test_one_worker_waits_as_pollaczek_and_khinchine_say(load: float) -> None:
    jobs = [Arrival(at, "fit-small", 1.0) for at in poisson(load, 100_000)]
    found = simulate(jobs, Pool(("fit-small",), 1, 1)).waits["fit-small"]
    assert sum(found) / len(found) == pytest.approx(load / (2 * (1 - load)), rel=0.05)


def test_several_workers_wait_as_erlang_says() -> None:
    chance = random.Random(1)  # noqa: S311
    jobs = [Arrival(at, "fit-small", chance.expovariate(1.0)) for at in poisson(2.4, 100_000)]
    found = simulate(jobs, Pool(("fit-small",), 3, 3)).waits["fit-small"]
    # M/M/3 at 0.8: Erlang's C is 0.6472, the mean wait C / (3 - 2.4).
    assert sum(found) / len(found) == pytest.approx(0.6472 / 0.6, rel=0.08)


def test_what_goes_first_hardly_waits() -> None:
    jobs = [
        Arrival(at, queue, 1.0)
        for n, at in enumerate(poisson(0.9, 50_000))
        for queue in [("extract", "fit-small")[n % 5 > 0]]
    ]
    found = simulate(jobs, Pool(("extract", "fit-small"), 1, 1))
    assert found.wait("extract", 0.95) < 3 < found.wait("fit-small", 0.95)


def test_a_burst_waits_for_workers_to_start_and_they_leave_afterwards() -> None:
    burst = [Arrival(0.1, "fit-small", 10.0) for _ in range(100)]
    later = [Arrival(5_000.0, "fit-small", 10.0)]
    pool = Pool(("fit-small",), 1, 50, entries=1.0, start_seconds=60.0, idle_seconds=300.0)
    found = simulate(burst + later, pool)
    assert found.peak == 50
    waits = found.waits["fit-small"]
    assert waits[0] == 0.0
    assert sorted(waits)[-2] == pytest.approx(80.0, abs=11.0)  # 60 s of start, then 50 at a time
    assert found.busy == pytest.approx(1010.0)
    # 49 of them were paid for the burst and some minutes, not until the job that came later.
    assert found.paid < 1.5 * 50 * (60 + 20 + 300) + 5_000


def test_arrivals_come_as_often_as_they_should_and_most_at_noon() -> None:
    kinds = (Kind("extract", 8.0, 0.5, 0.25), Kind("fit-small", 60.0, 0.1, 0.75))
    found = list(arrivals(20_000, kinds, 0.0, 86_400.0, seed=2))
    assert len(found) == pytest.approx(20_000, rel=0.03)
    noon = sum(39_600 < job.at < 46_800 for job in found)
    night = sum(job.at < 3_600 or job.at > 82_800 for job in found)
    assert noon / night == pytest.approx(1.8 / 0.2, rel=0.25)
    fits = [job.seconds for job in found if job.queue == "fit-small"]
    assert sum(fits) / len(fits) == pytest.approx(60.0, rel=0.02)
