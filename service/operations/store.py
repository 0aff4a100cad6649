"""Which workers are alive: those that signed within the last seconds, by the clock of Redis."""

from __future__ import annotations

from typing import Any

from redis import Redis

ALIVE_SECONDS = 15.0
FORGET_SECONDS = 3600.0
_SIGNATURES = "mpf:workers"


class WorkerRegister:
    """Workers sign here every few seconds."""

    def __init__(self, redis: Redis):
        self._redis = redis

    def sign(self, name: str) -> None:
        """Worker `name` is alive."""
        now = self._now()
        self._redis.zadd(_SIGNATURES, {name: now})
        self._redis.zremrangebyscore(_SIGNATURES, "-inf", now - FORGET_SECONDS)

    def leave(self, name: str) -> None:
        """Worker `name` ends in good order."""
        self._redis.zrem(_SIGNATURES, name)

    def alive(self) -> int:
        """How many have signed lately."""
        return int(self._redis.zcount(_SIGNATURES, self._now() - ALIVE_SECONDS, "+inf"))

    def _now(self) -> float:
        seconds, microseconds = self._redis.time()
        return float(seconds) + float(microseconds) / 1e6


class Turns:
    """Work that only one of all processes does, now and then."""

    def __init__(self, redis: Redis):
        self._redis = redis

    def take(self, name: str, seconds: float) -> bool:
        """Whether it is our turn; then nobody else's for `seconds` (0: it always is)."""
        if seconds <= 0:
            return True
        taken: Any = self._redis.set(f"mpf:turn:{name}", "", nx=True, px=int(seconds * 1000))
        return bool(taken)
