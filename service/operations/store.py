"""What workers tell of themselves: who is alive, by the clock of Redis, and how fast fits go."""

from __future__ import annotations

from typing import Any

from redis import Redis

ALIVE_SECONDS = 15.0
FORGET_SECONDS = 3600.0
_SIGNATURES = "mpf:workers"
_RATE = "mpf:rate"


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


class FitRate:
    """At which rate fits have gone here, so that the next one's time can be told."""

    NEWEST = 0.5
    """Share of the newest fit; machines change, and one fit may have shared its cores."""

    def __init__(self, redis: Redis):
        self._redis = redis

    def note(self, points_per_second: float) -> None:
        """A fit has ended that evaluated its field at so many samples a second."""
        before = self.points_per_second()
        mixed = (
            points_per_second
            if before is None
            else before + self.NEWEST * (points_per_second - before)
        )
        self._redis.set(_RATE, repr(mixed))

    def points_per_second(self) -> float | None:
        """Over the last fits; None before the first."""
        found: Any = self._redis.get(_RATE)
        return float(found) if found is not None else None
