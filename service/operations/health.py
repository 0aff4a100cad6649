"""Whether this process can do its part."""

from __future__ import annotations

from dataclasses import dataclass

from redis import Redis

from service.artifacts.base import Artifacts
from service.connection import RedisError
from service.operations.store import WorkerRegister


@dataclass(frozen=True)
class Readiness:
    """status: "ready", "degraded" (jobs wait: no worker is alive) or "unavailable"."""

    status: str
    redis: bool
    storage: bool
    workers: int


class Health:
    """Looks at what the service depends on."""

    def __init__(self, redis: Redis, artifacts: Artifacts):
        self._redis = redis
        self._artifacts = artifacts
        self._workers = WorkerRegister(redis)

    def readiness(self) -> Readiness:
        """Redis, the store and the workers, each asked once."""
        try:
            workers = self._workers.alive()
            redis_answers = bool(self._redis.ping())
        except RedisError:
            workers, redis_answers = 0, False
        storage = self._storage_writable()
        if not (redis_answers and storage):
            return Readiness("unavailable", redis_answers, storage, workers)
        return Readiness("ready" if workers else "degraded", True, True, workers)

    def _storage_writable(self) -> bool:
        try:
            self._artifacts.check_writable()
        except OSError:
            return False
        return True
