"""When a waiting job will be done, by what the workers say of themselves."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import fmean
from threading import Lock

from mpf_core.errors import OptionsError
from mpf_core.options import options_from
from mpf_core.tiles.count import tile_count
from service.jobs.model import FIT, TILE, Job, JobState
from service.jobs.queue import queue_for
from service.jobs.store import JobStore
from service.jobs.tiles import seconds_of
from service.operations.store import WorkerEntry, WorkerRegister
from service.settings import QUEUES, Settings

LOOK_SECONDS = 3.0
"""How old the figures may be that answers go by: thousands may ask at the same time."""


@dataclass(frozen=True)
class Outlook:
    """What is waiting and running, and who works.

    waiting: jobs by queue; left: seconds that each running job still takes
    """

    workers: Sequence[WorkerEntry]
    waiting: Mapping[str, int]
    left: Mapping[str, Sequence[float]]

    def pace(self, queue: str) -> float | None:
        """Seconds that a job of this queue takes, None while no worker has had one."""
        known = [worker.seconds[queue] for worker in self.workers if queue in worker.seconds]
        return fmean(known) if known else None

    def workers_of(self, queue: str) -> list[WorkerEntry]:
        """Those that take jobs from it."""
        return [worker for worker in self.workers if queue in worker.queues]

    def seconds_in_tiles(self, tiles: int, queue: str) -> float | None:
        """What a job of so many tiles takes, which will wait in `queue`; None: who knows."""
        pace, workers = self.pace(queue), self.workers_of(queue)
        return seconds_of(tiles, pace, len(workers)) if pace is not None and workers else None

    def seconds_to_end(self, queue: str, position: int, takes: float | None = None) -> float | None:
        """Until a job is done that has `position` others before it in `queue`; None: who knows.

        Workers of the queue share all that is before it: what runs on them, what waits in queues
        that go first, and the others of its own. That is an estimate, not a promise: those of
        queues that go first may still come.
        takes: seconds of the job itself, where they are not those of others in its queue
        """
        pace, workers = self.pace(queue), self.workers_of(queue)
        takes = pace if takes is None else takes
        if takes is None or not workers or (pace is None and position):
            return None
        pace = pace or 0.0
        queues = {name for worker in workers for name in worker.queues}
        running = [left for name in queues for left in self.left.get(name, ())]
        before = position * pace
        for first in QUEUES[: QUEUES.index(queue)]:
            if first in queues:
                before += self.waiting.get(first, 0) * (self.pace(first) or pace)
        if len(running) + position < len(workers) and before == position * pace:
            return takes  # one of them is free
        return (before + sum(running)) / len(workers) + takes


class Estimates:
    """One look at Redis serves everybody for a while. Safe to share between threads."""

    def __init__(
        self,
        store: JobStore,
        register: WorkerRegister,
        settings: Settings,
        clock: Callable[[], float] = time.monotonic,
    ):
        self._store = store
        self._register = register
        self._settings = settings
        self._clock = clock
        self._lock = Lock()
        self._looked_at = float("-inf")
        self._outlook = Outlook([], {}, {})

    def stale(self) -> bool:
        """Whether `refresh` would ask Redis."""
        return self._clock() - self._looked_at > LOOK_SECONDS

    def refresh(self) -> None:
        """Look again, unless somebody has just done so; raises RedisError."""
        with self._lock:
            if not self.stale():
                return
            workers = self._register.entries()
            waiting: dict[str, int] = {queue: self._store.waiting(queue) for queue in QUEUES}
            seen = Outlook(workers, waiting, {})
            left: dict[str, list[float]] = {}
            for job in self._store.running():
                if job.in_tiles:  # no worker has it
                    continue
                left.setdefault(job.queue, []).append(_left(job, seen, self._store.now()))
            self._outlook = Outlook(workers, waiting, left)
            self._looked_at = self._clock()

    def eta(self, job: Job, position: int | None) -> float | None:
        """Seconds until the job is done, as far as it can be told without asking again."""
        if job.state is JobState.RUNNING:
            if job.splitting and job.progress is None:
                return None
            return job.progress.eta if job.progress else self._outlook.pace(job.queue)
        if position is None or job.queue not in QUEUES:
            return None
        tiles = _tiles_to_come(job)
        if tiles == 1:
            return self._outlook.seconds_to_end(job.queue, position)
        takes = self._outlook.seconds_in_tiles(tiles, self._queue_of_tiles(job, tiles))
        if takes is None:
            return None
        return self._outlook.seconds_to_end(job.queue, position, takes)

    def _queue_of_tiles(self, job: Job, tiles: int) -> str:
        assert job.input is not None
        each = replace(job.input, points=(job.input.points or 0) // tiles)
        return queue_for(TILE, job.options, each, self._settings)


def _tiles_to_come(job: Job) -> int:
    """Into how many tiles its cloud will be split; 1: it will not be."""
    points = job.input.points or 0 if job.input is not None else 0
    if job.kind != FIT or job.split:
        return 1
    try:
        return tile_count(points, options_from(job.options))
    except OptionsError:  # a record of other software
        return 1


def _left(job: Job, seen: Outlook, now: float) -> float:
    if job.progress is not None and job.progress.eta is not None:
        return job.progress.eta
    taken = now - (job.started_at or 0) / 1000 if job.started_at else 0.0
    return max(0.0, (seen.pace(job.queue) or 0.0) - taken)
