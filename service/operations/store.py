"""What workers tell of themselves: who is alive, by the clock of Redis, what they can do, how fast
fits go."""

from __future__ import annotations

import json
import secrets
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from redis import Redis

ALIVE_SECONDS = 15.0
FORGET_SECONDS = 3600.0
_SIGNATURES = "mpf:workers"
_ENTRIES = "mpf:workers:about"
_RATE = "mpf:rate"


@dataclass(frozen=True)
class WorkerEntry:
    """What a worker tells of itself.

    queues: those that it takes jobs from, the first ones first
    threads: CPU threads of its fits; memory: of one job, bytes, 0: no limit
    seconds: how long a job of each queue took lately, for the queues it has had jobs of
    """

    queues: tuple[str, ...]
    threads: int
    memory: int
    seconds: Mapping[str, float] = field(default_factory=dict)


class WorkerRegister:
    """Workers sign here every few seconds."""

    def __init__(self, redis: Redis):
        self._redis = redis

    def sign(self, name: str, entry: WorkerEntry) -> None:
        """Worker `name` is alive."""
        now = self._now()
        with self._redis.pipeline() as pipeline:
            pipeline.zadd(_SIGNATURES, {name: now})
            pipeline.hset(_ENTRIES, name, json.dumps(asdict(entry)))
            pipeline.execute()
        gone: Any = self._redis.zrange(_SIGNATURES, "-inf", now - FORGET_SECONDS, byscore=True)
        if gone:
            self._redis.zrem(_SIGNATURES, *gone)
            self._redis.hdel(_ENTRIES, *gone)

    def leave(self, name: str) -> None:
        """Worker `name` ends in good order."""
        self._redis.zrem(_SIGNATURES, name)
        self._redis.hdel(_ENTRIES, name)

    def alive(self) -> int:
        """How many have signed lately."""
        return int(self._redis.zcount(_SIGNATURES, self._now() - ALIVE_SECONDS, "+inf"))

    def entries(self) -> list[WorkerEntry]:
        """What those tell of themselves that have signed lately."""
        names: Any = self._redis.zrange(
            _SIGNATURES, self._now() - ALIVE_SECONDS, "+inf", byscore=True
        )
        told: Any = self._redis.hmget(_ENTRIES, names) if names else []
        return [_entry(json.loads(text)) for text in told if text]

    def _now(self) -> float:
        seconds, microseconds = self._redis.time()
        return float(seconds) + float(microseconds) / 1e6


# KEYS[1] who; ARGV: name, ms.
_HOLD = """
local holder = redis.call('GET', KEYS[1])
if holder and holder ~= ARGV[1] then return 0 end
redis.call('SET', KEYS[1], ARGV[1], 'PX', ARGV[2])
return 1
"""


class Turns:
    """Work that only one of all processes does: now and then, or as long as it lives."""

    def __init__(self, redis: Redis):
        self._redis = redis
        self._name = secrets.token_hex(8)
        self._hold = redis.register_script(_HOLD)

    def hold(self, work: str, seconds: float) -> bool:
        """Whether this work is ours; it stays so as long as we ask again within `seconds`."""
        return bool(self._hold(keys=[f"mpf:turn:{work}"], args=[self._name, int(seconds * 1000)]))

    def take(self, name: str, seconds: float) -> bool:
        """Whether it is our turn; then nobody else's for `seconds` (0: it always is)."""
        if seconds <= 0:
            return True
        taken: Any = self._redis.set(f"mpf:turn:{name}", "", nx=True, px=int(seconds * 1000))
        return bool(taken)


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


def _entry(told: dict[str, Any]) -> WorkerEntry:
    return WorkerEntry(
        tuple(told["queues"]), int(told["threads"]), int(told["memory"]), told["seconds"]
    )
