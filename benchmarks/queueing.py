"""What a number of jobs a day takes: a simulation of queues, workers and autoscaling.

    python benchmarks/queueing.py cost draft     one job: core seconds, memory, bytes; two threads
    python benchmarks/queueing.py plan           the table of docs/operations.md
    python benchmarks/queueing.py check          a real service against the simulation's prediction

Jobs arrive at random at a rate that changes over the day. A pool of workers takes them from its
queues in their order, one each. An autoscaler looks at what waits every few seconds, as KEDA does,
and new workers need a while until they work.
"""

from __future__ import annotations

import argparse
import heapq
import json
import math
import os
import random
import resource
import subprocess
import sys
import tempfile
import time
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

DAY = 86_400.0


@dataclass(frozen=True)
class Kind:
    """Jobs of one kind: seconds that one occupies a worker (mean, and spread of its logarithm)."""

    queue: str
    seconds: float
    spread: float
    share: float


@dataclass(frozen=True)
class Pool:
    """Workers of some queues, and how they are scaled: one for every `entries` that wait."""

    queues: tuple[str, ...]
    least: int
    most: int
    entries: float = 1.0
    look_seconds: float = 10.0
    start_seconds: float = 60.0
    idle_seconds: float = 600.0


@dataclass
class Outcome:
    """waits: of each job by queue, s; busy, paid: worker seconds; peak: workers at one time."""

    waits: dict[str, list[float]] = field(default_factory=dict)
    busy: float = 0.0
    paid: float = 0.0
    peak: int = 0
    ends: float = 0.0

    def wait(self, queue: str, share: float) -> float:
        """The wait that this share of the jobs did not exceed, s."""
        found = sorted(self.waits.get(queue, ())) or [0.0]
        return found[min(len(found) - 1, int(share * len(found)))]


@dataclass(frozen=True)
class Arrival:
    """A job: when it comes, where it waits, how long it takes, s."""

    at: float
    queue: str
    seconds: float


def arrivals(
    per_day: float, kinds: Sequence[Kind], begin: float, end: float, seed: int, swing: float = 0.8
) -> Iterator[Arrival]:
    """Jobs from `begin` to `end` (s of the day); the rate swings by ±swing, highest at noon."""
    chance = random.Random(seed)  # noqa: S311
    highest = per_day / DAY * (1 + swing)
    weights = [kind.share for kind in kinds]
    now = begin
    while (now := now + chance.expovariate(highest)) < end:
        rate = 1 + swing * math.sin(2 * math.pi * (now / DAY - 0.25))
        if chance.random() * (1 + swing) > rate:
            continue
        (kind,) = chance.choices(kinds, weights)
        middle = math.log(kind.seconds) - kind.spread**2 / 2
        yield Arrival(now, kind.queue, chance.lognormvariate(middle, kind.spread))


def simulate(jobs: Sequence[Arrival] | Iterator[Arrival], pool: Pool) -> Outcome:
    """All jobs through one pool."""
    outcome = Outcome({queue: [] for queue in pool.queues})
    waiting: dict[str, deque[Arrival]] = {queue: deque() for queue in pool.queues}
    free, workers, coming = pool.least, pool.least, 0
    done: list[float] = []
    ready: list[float] = []
    coming_jobs = iter(jobs)
    job = next(coming_jobs, None)
    now = look = job.at if job else 0.0
    quiet_since = now
    while job is not None or done or any(waiting.values()):
        moments = [look if pool.most > pool.least else math.inf]
        moments += [job.at] if job else []
        moments += done[:1] + ready[:1]
        then = min(moments)
        outcome.paid += (workers + coming) * (then - now)
        now = then
        while job is not None and job.at <= now:
            waiting[job.queue].append(job)
            job = next(coming_jobs, None)
        while done and done[0] <= now:
            heapq.heappop(done)
            free += 1
        while ready and ready[0] <= now:
            heapq.heappop(ready)
            free, workers, coming = free + 1, workers + 1, coming - 1
        for queue in pool.queues:
            while free and waiting[queue]:
                taken = waiting[queue].popleft()
                outcome.waits[queue].append(now - taken.at)
                outcome.busy += taken.seconds
                heapq.heappush(done, now + taken.seconds)
                free -= 1
        if now >= look and pool.most > pool.least:
            entries = sum(map(len, waiting.values()))
            wanted = min(pool.most, max(pool.least, math.ceil(entries / pool.entries)))
            if entries:
                quiet_since = now
                for _ in range(wanted - workers - coming):
                    heapq.heappush(ready, now + pool.start_seconds)
                    coming += 1
            elif now - quiet_since > pool.idle_seconds and free:
                leave = min(free, workers - pool.least)
                free, workers = free - leave, workers - leave
            look = now + pool.look_seconds
        outcome.peak = max(outcome.peak, workers + coming)
    outcome.ends = now
    return outcome


# What jobs take on a worker with two cores: of fits the presets' budgets, which are upper bounds,
# and two seconds for a process of its own; of extractions an assumption.
START_SECONDS = 2.0
DRAFT, BALANCED = 55.0 + START_SECONDS, 165.0 + START_SECONDS
MIX = (
    Kind("extract", 8.0, 0.5, 0.2),
    Kind("fit-small", DRAFT, 0.1, 0.5),
    Kind("fit-small", BALANCED, 0.1, 0.3),
)
CORES = 2
QUEUES = ("extract", "fit-small")


def plan(per_day: float, seed: int = 0) -> dict[str, float]:
    """What so many jobs a day take: workers that KEDA starts, waits at the busiest hours."""
    mean = sum(kind.share * kind.seconds for kind in MIX)
    needed = per_day / DAY * mean
    # Of millions of jobs the busiest hours say enough.
    begin, end = (0.0, DAY) if per_day <= 1e6 else (0.48 * DAY, 0.52 * DAY)
    least = max(1, math.ceil(needed * (0.3 if per_day <= 1e6 else 1.85)))
    pool = Pool(QUEUES, least, max(2, math.ceil(2.2 * needed)), entries=1.0)
    found = simulate(arrivals(per_day, MIX, begin, end, seed), pool)
    return {
        "mean": needed,
        "peak": found.peak,
        "cores": found.peak * CORES,
        "median": found.wait("fit-small", 0.5),
        "p95": found.wait("fit-small", 0.95),
        "extract": found.wait("extract", 0.95),
        "used": found.busy / found.paid,
        "core_hours": needed * CORES * 24,
    }


def commands_per_second(running: float, workers: float) -> float:
    """What Redis is asked: by running jobs (settings' defaults) and by what every worker does."""
    progress, heed, beat = 1 / 0.5, 1 / 0.25, 1 / 1.0
    housekeeping = 6 / 3.0 + 2 / 1.0 + 8 / 30.0
    return running * (progress + heed + beat) + workers * housekeeping


COLUMNS = (
    "jobs a day", "workers, mean and most", "cores, most", "core hours a day",
    "wait of a fit, median and 95 %", "of an extraction, 95 %", "used", "kept in 7 days",
    "Redis commands/s",
)  # fmt: skip


def tell(text: str) -> None:
    """A line at once."""
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def tell_plan(megabytes: float) -> None:
    """As a Markdown table."""
    tell(f"| {' | '.join(COLUMNS)} |")
    tell("|" + " ---: |" * len(COLUMNS))
    for per_day in (1_000, 100_000, 10_000_000):
        told = plan(per_day)
        asked = commands_per_second(told["mean"], told["peak"])
        row = (
            f"{per_day:,}",
            f"{told['mean']:,.1f}, {told['peak']:,}",
            f"{told['cores']:,}",
            f"{told['core_hours']:,.0f}",
            f"{told['median']:.0f} s, {told['p95']:.0f} s",
            f"{told['extract']:.0f} s",
            f"{told['used']:.0%}",
            f"{per_day * 7 * megabytes / 1e6:,.2f} TB",
            f"{asked:,.0f}",
        )
        tell(f"| {' | '.join(row)} |")


def cost(preset: str, points: int, changes: dict[str, object]) -> dict[str, float]:
    """One job as a worker runs it, on a generated cloud; what it used and left behind.

    Processor seconds are told apart from those on the wall, which other work stretches.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        cloud = folder / "cloud.ply"
        subprocess.run(  # noqa: S603
            [sys.executable, "-m", "mpf_core", "sample", "potted-plant", "--points", str(points),
             "-o", str(cloud)], check=True, stdout=subprocess.DEVNULL,
        )  # fmt: skip
        code = (
            "import json, sys; from pathlib import Path; "
            "from mpf_core.options import options_from; "
            "from mpf_core.results import reconstruct_file; "
            "reconstruct_file(Path(sys.argv[1]), Path(sys.argv[2]), "
            "options_from(json.loads(sys.argv[3])))"
        )
        options = {"preset": preset, "threads": 2, **changes}
        begin = time.monotonic()
        subprocess.run(  # noqa: S603
            [sys.executable, "-c", code, str(cloud), str(folder / "out"), json.dumps(options)],
            check=True,
        )
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        files = [path for path in (folder / "out").rglob("*") if path.is_file()]
        report = json.loads((folder / "out" / "report.json").read_text())
        return {
            "seconds": time.monotonic() - begin,
            "core_seconds": used.ru_utime + used.ru_stime,
            "peak_mib": used.ru_maxrss / 1024,
            "iterations": report["fit"]["iterations"],
            "input_mb": cloud.stat().st_size / 1e6,
            "result_mb": sum(path.stat().st_size for path in files) / 1e6,
            "files": len(files),
        }


def check(count: int, load: float, seed: int) -> dict[str, float]:
    """A real service with one worker against what the simulation foretells.

    Jobs of the same kind: from some before and after, which are queued together, comes how long one
    occupies the worker; those in between arrive at random, at `load` of what the worker can do.
    Answers mean seconds; 95 % of the simulation's trials lie between low and high.
    """
    from tests.queueing_service import occupied, one_worker, waits  # real processes, as in tests

    with one_worker() as service:
        seconds = occupied(service, 5)
        mean = sum(seconds) / len(seconds)
        chance = random.Random(seed)  # noqa: S311
        at, moments = 0.0, []
        for _ in range(count):
            moments.append(at)
            at += chance.expovariate(load / mean)
        measured = waits(service, moments)
        seconds += occupied(service, 5)
        mean = sum(seconds) / len(seconds)
    foretold = []
    for trial in range(200):
        draw = random.Random(trial)  # noqa: S311
        jobs = [Arrival(moment, "fit-small", draw.choice(seconds)) for moment in moments]
        found = simulate(jobs, Pool(("fit-small",), 1, 1))
        foretold.append(sum(found.waits["fit-small"]) / count)
    foretold.sort()
    return {
        "occupied": mean,
        "measured": sum(measured) / count,
        "foretold": sum(foretold) / len(foretold),
        "low": foretold[5],
        "high": foretold[-6],
    }


def main() -> None:
    """One of the three."""
    parser = argparse.ArgumentParser()
    parser.add_argument("what", choices=("cost", "plan", "check"))
    parser.add_argument("preset", nargs="?", default="draft")
    parser.add_argument("--points", type=int, default=20_000)
    parser.add_argument("--set", action="append", default=[], metavar="NAME=NUMBER")
    parser.add_argument("--megabytes", type=float, default=10.0, help="kept of one job")
    parser.add_argument("--count", type=int, default=12)
    parser.add_argument("--load", type=float, default=0.8)
    given = parser.parse_args()
    if given.what == "plan":
        tell_plan(given.megabytes)
        return
    if given.what == "cost":
        changes = {
            name: json.loads(value) for name, _, value in (s.partition("=") for s in given.set)
        }
        found = cost(given.preset, given.points, changes)
    else:
        sys.path.insert(0, os.fspath(Path(__file__).resolve().parents[1]))
        found = check(given.count, given.load, seed=1)
    tell("\n".join(f"{name}: {value:.2f}" for name, value in found.items()))


if __name__ == "__main__":
    main()
