"""What every worker does beside its jobs, in a thread: sign the register, reap."""

from __future__ import annotations

import logging
import threading

from redis.exceptions import RedisError

from service.artifacts.store import ArtifactStore
from service.connection import connect
from service.jobs.queue import JobQueue
from service.jobs.store import JobStore
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
        self._reaper = Reaper(
            JobStore(redis, retention_seconds=settings.retention_seconds),
            queue,
            ArtifactStore(settings.data_dir),
            settings,
        )
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
        except RedisError as error:
            log.warning("housekeeping waits for Redis: %s", error)
        except Exception:
            log.exception("housekeeping failed this time")
