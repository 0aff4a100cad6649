"""What Prometheus reads; every figure comes from Redis, so that any replica tells the same."""

from __future__ import annotations

from collections.abc import Iterator

from service.artifacts.base import Artifacts
from service.jobs.model import Job, JobState
from service.jobs.store import JobStore
from service.operations.store import WorkerRegister
from service.settings import QUEUES

MEDIA_TYPE = "text/plain; version=0.0.4; charset=utf-8"


class Metrics:
    """Text in Prometheus' exposition format."""

    def __init__(self, store: JobStore, workers: WorkerRegister, artifacts: Artifacts):
        self._store = store
        self._workers = workers
        self._artifacts = artifacts

    def text(self) -> str:
        """All figures, each asked once."""
        return "\n".join(self._lines()) + "\n"

    def _lines(self) -> Iterator[str]:
        yield from _family("mpf_jobs", "gauge", "Jobs by state.")
        for state in JobState:
            yield f'mpf_jobs{{state="{state}"}} {self._store.count(state)}'
        oldest = self._store.oldest_queued_seconds()
        yield from _single(
            "mpf_queue_oldest_seconds", "gauge", "Wait of the first queued job, s.", oldest
        )
        yield from _family("mpf_queue_jobs", "gauge", "Jobs that wait, by queue.")
        for queue in QUEUES:
            yield f'mpf_queue_jobs{{queue="{queue}"}} {self._store.waiting(queue)}'
        workers = self._workers.entries()
        yield from _family("mpf_queue_workers", "gauge", "Workers that take from each queue.")
        for queue in QUEUES:
            number = sum(queue in worker.queues for worker in workers)
            yield f'mpf_queue_workers{{queue="{queue}"}} {number}'
        yield from _single(
            "mpf_workers", "gauge", "Workers that signed lately.", self._workers.alive()
        )
        free = self._artifacts.free_fraction()
        yield from _single("mpf_disk_free_fraction", "gauge", "Of the artefact store.", free)
        speed = sum(_iterations_per_second(job) for job in self._store.running())
        yield from _single(
            "mpf_iterations_per_second", "gauge", "Optimiser steps of all running jobs.", speed
        )
        yield from self._counts()

    def _counts(self) -> Iterator[str]:
        counts = self._store.counts()
        seconds = counts.pop("run_milliseconds", 0) / 1000
        yield from _family("mpf_jobs_ended_total", "counter", "Ended jobs by state and code.")
        for name, number in sorted(counts.items()):
            state, _, code = name.partition(" ")
            yield f'mpf_jobs_ended_total{{state="{state}",code="{code}"}} {number}'
        yield from _single(
            "mpf_run_seconds_total", "counter", "Time from start to end of ended jobs, s.", seconds
        )


def _iterations_per_second(job: Job) -> float:
    progress = job.progress
    if progress is None or not progress.iteration or progress.seconds <= 0:
        return 0.0
    return progress.iteration / progress.seconds


def _family(name: str, kind: str, about: str) -> Iterator[str]:
    yield f"# HELP {name} {about}"
    yield f"# TYPE {name} {kind}"


def _single(name: str, kind: str, about: str, value: float) -> Iterator[str]:
    yield from _family(name, kind, about)
    yield f"{name} {value:g}"
