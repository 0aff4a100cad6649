"""Deliveries that are due, and the log of those that were tried.

`jobs/store.py` puts a delivery here within the same atomic change that it tells of.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import Any

from redis import Redis

DUE_KEY = "mpf:webhooks:due"
_TRIES_KEY = "mpf:webhooks:tries"
LOG_KEPT = 50

# KEYS: due, tries; ARGV: ms for which nobody else may take it. Answers {delivery, try} or {}.
_CLAIM = """
local t = redis.call('TIME')
local now = t[1] * 1000 + math.floor(t[2] / 1000)
local first = redis.call('ZRANGE', KEYS[1], '-inf', now, 'BYSCORE', 'LIMIT', 0, 1)[1]
if not first then return {} end
redis.call('ZADD', KEYS[1], now + tonumber(ARGV[1]), first)
return {first, redis.call('HINCRBY', KEYS[2], first, 1)}
"""


def log_key(job_id: str) -> str:
    """The list of a job's deliveries, latest first."""
    return f"mpf:job:{job_id}:deliveries"


@dataclass(frozen=True)
class Delivery:
    """One event that one receiver should hear of; `number` counts the tries from 1."""

    job_id: str
    event_id: str
    number: int

    def name(self) -> str:
        """As it stands in Redis."""
        return f"{self.job_id} {self.event_id}"


@dataclass(frozen=True)
class Tried:
    """One try, as the log shows it. status: of HTTP, or 0 if there was no answer."""

    event_id: str
    number: int
    at: float
    status: int
    error: str


class WebhookStore:
    """Any number of processes may take deliveries."""

    def __init__(self, redis: Redis):
        self._redis = redis
        self._claim = redis.register_script(_CLAIM)

    def claim(self, seconds: float) -> Delivery | None:
        """Take the first that is due; after `seconds` without a word others may take it."""
        reply: Any = self._claim(keys=[DUE_KEY, _TRIES_KEY], args=[int(seconds * 1000)])
        if not reply:
            return None
        job_id, _, event_id = _text(reply[0]).partition(" ")
        return Delivery(job_id, event_id, int(reply[1]))

    def done(self, delivery: Delivery) -> None:
        """It arrived, or is given up."""
        self._redis.zrem(DUE_KEY, delivery.name())
        self._redis.hdel(_TRIES_KEY, delivery.name())

    def later(self, delivery: Delivery, seconds: float) -> None:
        """Try again after `seconds`."""
        at = (float(self._redis.time()[0]) + seconds) * 1000
        self._redis.zadd(DUE_KEY, {delivery.name(): at}, xx=True)

    def note(self, delivery: Delivery, status: int, error: str) -> None:
        """Write a try into the job's log."""
        now = float(self._redis.time()[0])
        tried = Tried(delivery.event_id, delivery.number, now, status, error)
        key = log_key(delivery.job_id)
        self._redis.lpush(key, json.dumps(asdict(tried)))
        self._redis.ltrim(key, 0, LOG_KEPT - 1)

    def log(self, job_id: str) -> list[Tried]:
        """The latest tries first."""
        entries: Any = self._redis.lrange(log_key(job_id), 0, -1)
        return [Tried(**json.loads(entry)) for entry in entries]


def _text(value: bytes | str) -> str:
    return value.decode() if isinstance(value, bytes) else value
