"""What every worker does beside its jobs, in threads: sign the register, reap, expire, deliver."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

from redis.exceptions import RedisError

from service.artifacts.opened import artifacts_of
from service.connection import connect
from service.events.store import EventStore
from service.jobs.queue import JobQueue
from service.jobs.tile_store import TileStore
from service.operations.retention import Retention
from service.operations.store import Turns, WorkerRegister
from service.settings import Settings
from service.webhooks.store import WebhookStore
from worker.pace import Pace
from worker.reaper import Reaper
from worker.webhooks import Deliverer

log = logging.getLogger("mpf.worker")

ROUND_SECONDS = 3.0
WEBHOOK_ROUND_SECONDS = 1.0


class Loop:
    """Calls `act` again and again in a thread; an error in one round does not end the next."""

    def __init__(self, name: str, every: float, act: Callable[[], None]):
        self._name = name
        self._every = every
        self._act = act
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        """Begin at once."""
        self._thread.start()

    def stop(self) -> None:
        """After the round that is under way, which is waited for a little."""
        self._over.set()
        self._thread.join(timeout=5)

    def _run(self) -> None:
        while True:
            try:
                self._act()
            except RedisError as error:
                log.warning("%s waits for Redis: %s", self._name, error)
            except Exception:
                log.exception("%s failed this time", self._name)
            if self._over.wait(self._every):
                return


def pulse(settings: Settings) -> None:
    """Show whoever looks at this machine only that the worker lives."""
    if settings.pulse_file is not None:
        settings.pulse_file.touch()


class Housekeeping:
    """Runs while the worker lives."""

    def __init__(self, name: str, pace: Pace, settings: Settings):
        redis = connect(settings)
        register = WorkerRegister(redis)
        queue = JobQueue(redis, job_seconds=settings.job_seconds)
        store = TileStore(
            redis,
            retention_seconds=settings.retention_seconds,
            progress_seconds=settings.progress_seconds,
        )
        artifacts = artifacts_of(settings)
        reaper = Reaper(store, queue, artifacts, settings, register, Turns(redis))
        retention = Retention(store, artifacts, settings)
        deliverer = Deliverer(WebhookStore(redis), store, EventStore(redis), settings)
        self._loops = [
            Loop("pulse", ROUND_SECONDS, lambda: pulse(settings)),
            Loop("register", ROUND_SECONDS, lambda: register.sign(name, pace.entry())),
            Loop("reaper", ROUND_SECONDS, reaper.look),
            Loop("retention", settings.retention_round_seconds, retention.round),
            Loop("webhooks", WEBHOOK_ROUND_SECONDS, deliverer.round),
        ]

    def __enter__(self) -> Housekeeping:
        for loop in self._loops:
            loop.start()
        return self

    def __exit__(self, *_: object) -> None:
        for loop in self._loops:
            loop.stop()
