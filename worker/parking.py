"""Jobs whose owner runs as many as it may wait without an entry in the queue, in nobody's way."""

from __future__ import annotations

import logging
from collections import Counter

from service.jobs.model import TILE, JobState
from service.jobs.queue import JobQueue
from service.jobs.store import JobStore

log = logging.getLogger("mpf.worker")


class Parking:
    """Any number of processes may use it: the record decides who starts, this only saves tries.

    A job that was let out by mistake is refused by `JobStore.start` and parked again; one that was
    forgotten is enqueued by the reaper.
    """

    def __init__(self, store: JobStore, queue: JobQueue, most: int):
        self._store = store
        self._queue = queue
        self._most = most

    def park(self, job_id: str) -> bool:
        """Whether this queued job must wait for others of its owner; it is parked then.

        A job that was split counts as one with all its tiles, from its start to its end.
        """
        if not self._most:
            return False
        job = self._store.get(job_id)
        if job is None or job.state is not JobState.QUEUED or job.kind == TILE or job.split:
            return False
        if self._store.running_of(job.owner) < self._most:
            return False
        log.info("job %s: waits for others of its owner", job_id)
        self._store.park(job_id)
        return True

    def let_out(self) -> None:
        """Enqueue as many parked jobs as may run now, those first that came first."""
        let: Counter[str] = Counter()
        for job in self._store.parked():
            room = self._most - self._store.running_of(job.owner) - let[job.owner]
            if self._most and room <= 0 and job.state is JobState.QUEUED:
                continue
            # Whoever takes it out of the set enqueues it.
            if self._store.unpark(job.id) and job.state is JobState.QUEUED:
                let[job.owner] += 1
                self._queue.enqueue(job, job.attempt)
