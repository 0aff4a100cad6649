"""The one task that RQ starts, dispatching on the job's kind.

Whatever happens in here ends in exactly one change of the record, made under this attempt's lease.
"""

from __future__ import annotations

import errno
import logging
import os
import secrets
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any, TypeVar

from redis import Redis
from rq import get_current_job
from rq.timeouts import JobTimeoutException

from mpf_core.errors import Cancelled, MPFError
from service.artifacts.base import StoreUnavailable
from service.artifacts.opened import artifacts_of
from service.connection import UNREACHABLE, connect
from service.jobs.family import cancelled_problem
from service.jobs.lease import Changed, Lease, Refused
from service.jobs.model import RESULTS, Job
from service.jobs.queue import JobQueue, attempt_of
from service.jobs.tile_store import TileStore
from service.logs import about
from service.operations.store import FitRate
from service.problems import Problem, problem_from
from service.settings import Settings
from worker.memory import is_out_of_memory
from worker.preview import PreviewWriter
from worker.report import Reporter
from worker.runners import RUNNERS, SPLIT, Run, work_of
from worker.settle import out_of_memory_problem, time_limit_problem
from worker.tiles import TileWork

log = logging.getLogger("mpf.worker")

T = TypeVar("T")

STORE_PAUSE_SECONDS = 1.0
"""Between two tries to reach the artefact store, or Redis."""

AWAY = (StoreUnavailable, *UNREACHABLE)
"""What an attempt meets while one of them is away."""


def run(job_id: str) -> None:
    """RQ's entry point: `job_id` is the only argument, the attempt stands in the entry's id."""
    entry = get_current_job()
    assert entry is not None
    _, attempt = attempt_of(entry.id)
    settings = Settings()
    lease = Lease(job_id, attempt, os.environ["RQ_WORKER_ID"])
    with about(job_id):
        Attempt(lease, connect(settings), settings).run()


class Attempt:
    """Takes the lease, runs the job, writes how it ended."""

    def __init__(self, lease: Lease, redis: Redis, settings: Settings):
        self._lease = lease
        self._settings = settings
        self._store = TileStore(
            redis,
            retention_seconds=settings.retention_seconds,
            progress_seconds=settings.progress_seconds,
        )
        self._queue = JobQueue(redis, job_seconds=settings.job_seconds)
        self._artifacts = artifacts_of(settings)
        self._artifacts.prepare()
        self._tiles = TileWork(self._store, self._queue, self._artifacts, lease, settings)
        self._reporter = Reporter(self._store, lease, settings)
        self._rate = FitRate(redis)

    def run(self) -> None:
        """From `queued` to wherever it ends."""
        try:
            job = self._start()
        except Refused as refusal:
            log.info("job %s: attempt %s not started: %s", *self._name(), refusal)
            return
        log.info("job %s: attempt %s starts", *self._name())
        try:
            self._finish(self._outcome(job))
        finally:
            self._discard()
        # Without its lease this process may be killed any moment: from here on a reaper would do.
        self._tiles.ended(job)

    def _discard(self) -> None:
        try:
            self._artifacts.discard_work(*self._name())
        except StoreUnavailable as error:
            log.warning("job %s: left to the removal of the job: %s", self._name()[0], error)

    def _outcome(self, job: Job) -> Callable[[], Changed]:
        """Run the job; what comes back writes the record."""
        try:
            return self._perform(job)
        except Cancelled:
            return self._stopped
        except MPFError as error:
            return self._failed(problem_from(error).as_dict())
        except JobTimeoutException:
            return self._failed(time_limit_problem(self._settings))
        except AWAY as error:
            return self._without_store(error, job)
        except Exception as error:
            return self._failed(self._unexpected(error))

    def _perform(self, job: Job) -> Callable[[], Changed]:
        job_id, attempt = self._name()
        # The last attempt begins anew: it may be what was kept that ended the others.
        inherit = job.tries < self._settings.max_attempts
        given = self._patiently(lambda: self._artifacts.input(job_id, attempt))
        work = work_of(job, given)
        self._patiently(lambda: self._tiles.begin(work))
        self._reporter = Reporter(
            self._store, self._lease, self._settings, self._tiles.part(job, work)
        )
        gathered = self._patiently(lambda: self._tiles.gathered(job))
        with self._artifacts.checkpoint(job_id, attempt, inherit=inherit) as checkpoint:
            run = Run(
                job,
                self._settings.threads_per_job(),
                given,
                self._artifacts.work(job_id, attempt),
                self._reporter,
                preview=PreviewWriter(self._store, self._artifacts, self._lease),
                checkpoint=checkpoint,
                gathered=gathered,
            )
            RUNNERS[work](run)
        samples = self._tiles.samples(run.out) if work == SPLIT else {}
        self._note_rate()
        files = self._patiently(lambda: self._artifacts.publish(job_id, attempt))
        if work == SPLIT:
            made = self._patiently(lambda: self._tiles.made(job, files, samples))
            return lambda: self._tiles.hand_out(made)
        return lambda: self._store.succeed(self._lease, files)

    def _start(self) -> Job:
        before = self._store.get(self._lease.job_id)
        anew = before is None or not before.split
        return self._store.start(self._lease, self._settings.running_per_owner, anew=anew)

    def _patiently(self, act: Callable[[], T]) -> T:
        """Wait for the artefact store and Redis while one of them is away; raises Cancelled once
        that is in vain."""
        deadline = time.monotonic() + self._settings.redis_patience_seconds
        while True:
            try:
                return act()
            except AWAY as error:
                if self._reporter.cancel():
                    raise Cancelled("the job is not ours any more") from error
                if time.monotonic() > deadline:
                    raise
                log.warning("job %s: attempt %s waits: %s", *self._name(), error)
                time.sleep(STORE_PAUSE_SECONDS)

    def _without_store(self, error: Exception, job: Job) -> Callable[[], Changed]:
        """Another worker may reach what this one cannot; the last attempt ends."""
        log.warning("job %s: attempt %s gives up: %s", *self._name(), error)
        if job.tries < self._settings.max_attempts:
            return self._handed_back
        away = "Redis" if isinstance(error, UNREACHABLE) else "the artefact store"
        problem = Problem("service.unavailable", f"{away} does not answer")
        return self._failed(problem.as_dict())

    def _note_rate(self) -> None:
        """For those who ask what the next fit will take."""
        rate = self._reporter.points_per_second()
        if rate is not None:
            try:
                self._rate.note(rate)
            except UNREACHABLE as error:
                log.warning("job %s: its rate is not noted: %s", self._lease.job_id, error)

    def _failed(self, problem: Mapping[str, Any]) -> Callable[[], Changed]:
        log.info("job %s: attempt %s fails: %s", *self._name(), problem.get("code"))
        return lambda: self._store.fail(self._lease, problem)

    def _unexpected(self, error: Exception) -> Mapping[str, Any]:
        if is_out_of_memory(error):
            return out_of_memory_problem()
        if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
            return Problem("storage.full", "there was no room for the result").as_dict()
        incident = secrets.token_hex(4)
        log.error("job %s: attempt %s, incident %s", *self._name(), incident, exc_info=error)
        return Problem("internal", f"incident {incident}: see the worker's log").as_dict()

    def _stopped(self) -> Changed:
        if self._reporter.reason == "hand back":
            return self._handed_back()
        return self._store.cancelled(self._lease, cancelled_problem())

    def _handed_back(self) -> Changed:
        changed = self._store.hand_back(self._lease)
        job = self._store.get(self._lease.job_id)
        if job is not None:
            self._queue.enqueue(job, changed.attempt)
        return changed

    def _finish(self, write: Callable[[], Changed]) -> None:
        """Write how it ended, waiting for Redis if it is away."""
        deadline = time.monotonic() + self._settings.redis_patience_seconds
        while True:
            try:
                changed = write()
            except Refused as refusal:
                # Fenced, or an answer was lost and the change had been made.
                log.info("job %s: attempt %s is over already: %s", *self._name(), refusal)
                return
            except UNREACHABLE as error:
                if time.monotonic() > deadline:
                    raise
                log.warning("job %s: attempt %s waits for Redis: %s", *self._name(), error)
                time.sleep(0.5)
            else:
                log.info("job %s: attempt %s ends %s", *self._name(), changed.state)
                if changed.state in RESULTS:
                    with suppress(StoreUnavailable):
                        self._artifacts.forget_checkpoints(self._lease.job_id)
                return

    def _name(self) -> tuple[str, int]:
        return self._lease.job_id, self._lease.attempt
