"""What every worker does beside its jobs, in a thread: sign the register, reap, expire."""

from __future__ import annotations

import logging
import math
import threading
import time

from redis.exceptions import RedisError

from service.artifacts.store import ArtifactStore
from service.connection import connect
from service.jobs.queue import JobQueue
from service.jobs.store import JobStore
from service.operations.retention import Retention
from service.operations.store import WorkerRegister
from service.settings import Settings
from worker.reaper import Reaper

log = logging.getLogger("mpf.worker")

EVERY_SECONDS = 3.0


class Housekeeping:
    """Runs while the worker lives; an error in one round does not end the next."""

    def __init__(self, name: str, settings: Settings):
        redis = connect(settings)
        self._name = name
        self._register = WorkerRegister(redis)
        queue = JobQueue(redis, job_seconds=settings.job_seconds)
        store = JobStore(redis, retention_seconds=settings.retention_seconds)
        artifacts = ArtifactStore(settings.data_dir)
        self._reaper = Reaper(store, queue, artifacts, settings)
        self._retention = Retention(store, artifacts, settings)
        self._retention_at = -math.inf
        self._retention_every = settings.retention_round_seconds
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="housekeeping", daemon=True)

    def __enter__(self) -> Housekeeping:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join(timeout=10)

    def _run(self) -> None:
        while True:
            self._round()
            if self._over.wait(EVERY_SECONDS):
                return

    def _round(self) -> None:
        try:
            self._register.sign(self._name)
            self._reaper.look()
            if time.monotonic() - self._retention_at > self._retention_every:
                self._retention_at = time.monotonic()
                self._retention.round()
        except RedisError as error:
            log.warning("housekeeping waits for Redis: %s", error)
        except Exception:
            log.exception("housekeeping failed this time")
