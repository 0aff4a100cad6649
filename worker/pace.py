"""How long this worker's jobs take, by queue: what its entry in the register says."""

from __future__ import annotations

from service.jobs.model import Job, JobState
from service.operations.store import WorkerEntry
from service.settings import Settings
from worker.memory import memory_per_job

WEIGHT = 0.3
"""Of the latest job against all before it: the mean follows a change within a few jobs."""


class Pace:
    """A moving mean per queue. Written by one thread, read by another."""

    def __init__(self, settings: Settings):
        self._settings = settings
        self._seconds: dict[str, float] = {}

    def note(self, job: Job | None) -> None:
        """A job has ended here; one that did not succeed says nothing of how long jobs take, and
        one that was split ends with a part of it."""
        if job is None or job.state is not JobState.SUCCEEDED or job.split:
            return
        if job.started_at is None or job.finished_at is None:
            return
        took = (job.finished_at - job.started_at) / 1000
        before = self._seconds.get(job.queue, took)
        self._seconds = self._seconds | {job.queue: before + WEIGHT * (took - before)}

    def entry(self) -> WorkerEntry:
        """What the register is to say."""
        settings = self._settings
        return WorkerEntry(
            settings.queues, settings.threads_per_job(), memory_per_job(settings), self._seconds
        )
