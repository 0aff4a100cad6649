"""Finds jobs that nobody works on: a lease whose beats have stopped, a queued job RQ forgot, one
whose tiles are all fitted.

Time is this process's own monotonic clock between two looks at the same sight; no clock of another
machine, and no wall clock, takes part. Any number of reapers may run: each change is fenced.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable

from service.artifacts.base import Artifacts
from service.jobs.family import Families, cancelled_problem
from service.jobs.lease import Refused
from service.jobs.model import Job, JobState
from service.jobs.queue import JobQueue, entry_id
from service.jobs.tile_store import TileStore
from service.operations.store import Turns, WorkerRegister
from service.settings import Settings
from worker.parking import Parking
from worker.settle import crashed_problem, forget_if_ended

log = logging.getLogger("mpf.worker")

Clock = Callable[[], float]

# A queued job without an entry for this long was lost between the two.
LOST_ENTRY_SECONDS = 10.0


# Each look reads all that waits and runs. A few workers may all do so, the sooner a lost one is
# found; of many only one does, and another one after this time should that be the one that is lost.
FEW_WORKERS = 8
REAPER_SECONDS = 10.0


class Watch:
    """Since when each sight has looked the same."""

    def __init__(self, clock: Clock):
        self._clock = clock
        self._seen: dict[str, tuple[object, float]] = {}

    def unchanged_for(self, job_id: str, sight: object) -> float:
        """Seconds for which `job_id` has shown `sight`; 0 on a first or a new one."""
        now = self._clock()
        before = self._seen.get(job_id)
        if before is None or before[0] != sight:
            self._seen[job_id] = (sight, now)
            return 0.0
        return now - before[1]

    def forget_all_but(self, job_ids: set[str]) -> None:
        """Drop what is no longer looked at."""
        for gone in self._seen.keys() - job_ids:
            del self._seen[gone]


class Reaper:
    """One look at a time; whoever owns it calls `look` every few seconds."""

    def __init__(
        self,
        store: TileStore,
        queue: JobQueue,
        artifacts: Artifacts,
        settings: Settings,
        register: WorkerRegister,
        turns: Turns,
        clock: Clock = time.monotonic,
    ):
        self._register = register
        self._turns = turns
        self._store = store
        self._queue = queue
        self._artifacts = artifacts
        self._settings = settings
        self._parking = Parking(store, queue, settings.running_per_owner)
        self._families = Families(store, queue, artifacts)
        self._running = Watch(clock)
        self._queued = Watch(clock)

    def look(self) -> None:
        """Requeue what has lost its worker or its entry, unless another worker sees to that."""
        many = self._register.alive() > FEW_WORKERS
        if many and not self._turns.hold("reaper", REAPER_SECONDS):
            return
        self._look_at_running()
        self._families.look_at_all()
        self._parking.let_out()
        self._look_at_queued()

    def _look_at_running(self) -> None:
        ids = self._store.in_state(JobState.RUNNING)
        self._running.forget_all_but(set(ids))
        for job_id in ids:
            job = self._store.get(job_id)
            if job is None or job.state is not JobState.RUNNING or job.in_tiles:
                continue
            still = self._running.unchanged_for(job_id, (job.lease, job.beats))
            if still > self._settings.lease_seconds:
                self._take_back(job)

    def _take_back(self, job: Job) -> None:
        log.warning("job %s: attempt %s has lost its worker", job.id, job.attempt)
        try:
            if job.given_up:
                self._store.reap_cancelled(job, cancelled_problem())
            elif job.tries >= self._settings.max_attempts:
                self._store.reap_failed(job, crashed_problem(job.tries))
            else:
                changed = self._store.reap(job)
                self._queue.enqueue(job, changed.attempt)
            self._artifacts.discard_work(job.id, job.attempt)
            forget_if_ended(job.id, self._store, self._artifacts)
        except Refused as refusal:
            log.info("job %s: not reaped: %s", job.id, refusal)

    def _look_at_queued(self) -> None:
        waiting = self._queue.waiting()
        parked = {job.id for job in self._store.parked()}
        lost: set[str] = set()
        for job_id in self._store.in_state(JobState.QUEUED):
            job = self._store.get(job_id)
            if job is None or job_id in parked or entry_id(job_id, job.attempt) in waiting:
                continue
            lost.add(job_id)
            if self._queued.unchanged_for(job_id, job.attempt) > LOST_ENTRY_SECONDS:
                log.warning("job %s: its queue entry is lost; enqueued again", job_id)
                self._queue.enqueue(job, job.attempt)
        self._queued.forget_all_but(lost)
