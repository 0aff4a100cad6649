"""The end of things: ended jobs expire, tombstones go, files that belong to nobody are removed."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from contextlib import suppress

from service.artifacts.base import Artifacts, StoreUnavailable
from service.connection import connect
from service.jobs.lease import Refused
from service.jobs.model import JobState
from service.jobs.store import JobStore
from service.operations.store import Turns
from service.problems import Problem
from service.settings import Settings
from service.uploads.opened import uploads_of

log = logging.getLogger("mpf.retention")

Clock = Callable[[], float]

BATCH = 100
"""Jobs per round, so that a round is short."""

JUMP_SECONDS = 60.0
"""A wall clock that moves this much against the monotonic one has jumped."""

CALM_SECONDS = 3600.0
"""After a jump nothing expires for this long: somebody may yet set the clock right."""


class ClockWatch:
    """Whether the wall clock can be believed when it says that something is old."""

    def __init__(self, wall: Clock, steady: Clock):
        self._wall = wall
        self._steady = steady
        self._offset = wall() - steady()
        self._jumped_at: float | None = None

    def calm(self) -> bool:
        """False after a jump, for CALM_SECONDS."""
        offset, now = self._wall() - self._steady(), self._steady()
        if abs(offset - self._offset) > JUMP_SECONDS:
            log.warning(
                "the clock jumped by %.0f s; nothing expires for now", offset - self._offset
            )
            self._jumped_at = now
        self._offset = offset
        return self._jumped_at is None or now - self._jumped_at > CALM_SECONDS


class Retention:
    """One round at a time; any number of processes may run it."""

    def __init__(
        self,
        store: JobStore,
        artifacts: Artifacts,
        settings: Settings,
        *,
        wall: Clock = time.time,
        steady: Clock = time.monotonic,
    ):
        self._store = store
        self._artifacts = artifacts
        self._settings = settings
        redis = connect(settings)
        self._resumable = uploads_of(settings, redis)
        self._turns = Turns(redis)
        self._wall = wall
        # The ages of records are by the clock of Redis, which runs where the jobs were stamped.
        # Those of files are by ours; either may jump.
        self._watches = (ClockWatch(store.now, steady), ClockWatch(wall, steady))

    def round(self) -> None:
        """Expire what is due, make room if the disk is nearly full, remove what is nobody's."""
        calm = [watch.calm() for watch in self._watches]
        if not all(calm):
            return
        for job_id in self._store.due(BATCH):
            self._expire(job_id, "its time was over")
        self._make_room()
        self._remove_tombstones()
        self._remove_orphans()

    def _make_room(self) -> None:
        """Ended jobs go early, those that would go first before the others."""
        while self._artifacts.free_fraction() < self._settings.disk_low_fraction:
            first = self._store.first_to_expire(10)
            if not first:
                return
            for job_id in first:
                self._expire(job_id, "the disk was nearly full")

    def _expire(self, job_id: str, why: str) -> None:
        problem = Problem("job.expired", f"the job's files were removed: {why}")
        with suppress(Refused):
            self._store.expire(job_id, problem.as_dict())
            with suppress(StoreUnavailable):  # they go with the tombstone, as files of nobody
                self._artifacts.remove(job_id)
            log.info("job %s: expired, %s", job_id, why)

    def _remove_tombstones(self) -> None:
        horizon = self._store.now() - self._settings.tombstone_seconds
        for job_id in self._store.in_state(JobState.EXPIRED)[:BATCH]:
            job = self._store.get(job_id)
            if job is None or job.updated_at / 1000 > horizon:
                return  # the others are younger
            self._store.remove(job)

    def _remove_orphans(self) -> None:
        for name in self._artifacts.remove_leftovers(self._wall() - self._settings.orphan_seconds):
            log.info("%s: left over on this machine, removed", name)
        if not self._turns.take("orphans", self._artifacts.look_seconds):
            return
        for upload_id in self._resumable.remove_lapsed(self._wall()):
            log.info("upload %s: nothing more came, removed", upload_id)
        for job_id in list(self._artifacts.job_ids()):
            if self._store.get(job_id) is not None:
                continue
            with suppress(FileNotFoundError):
                age = self._artifacts.age(job_id, self._wall())
                if age > self._settings.orphan_seconds and self._store.get(job_id) is None:
                    self._artifacts.remove(job_id)
                    log.info("job %s: no such job, its files are removed", job_id)
