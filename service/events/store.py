"""The job's stream of events; `jobs/store.py` writes to it within its own atomic changes."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

from redis import Redis

# Tells every API process of a change of any job: "id state".
FEED_CHANNEL = "mpf:feed"

# Events kept per job; older ones are dropped, the record always has the latest state.
EVENTS_KEPT = 1000


def stream_key(job_id: str) -> str:
    """The stream that holds a job's events."""
    return f"mpf:job:{job_id}:events"


@dataclass(frozen=True)
class Event:
    """One thing that happened; ids grow and are those of the stream."""

    id: str
    name: str
    data: dict[str, Any]


class EventStore:
    """Reads only."""

    def __init__(self, redis: Redis):
        self._redis = redis

    def after(self, job_id: str, last: str, most: int = 200) -> list[Event]:
        """Events behind `last`, in their order."""
        entries: Any = self._redis.xrange(stream_key(job_id), f"({last}", "+", count=most)
        return [_event(*entry) for entry in entries]

    def one(self, job_id: str, event_id: str) -> Event | None:
        """That very event, if it is still kept."""
        entries: Any = self._redis.xrange(stream_key(job_id), event_id, event_id)
        return _event(*entries[0]) if entries else None

    def last_id(self, job_id: str) -> str:
        """The id of the latest event; "0-0" if there is none."""
        entries: Any = self._redis.xrevrange(stream_key(job_id), count=1)
        return _text(entries[0][0]) if entries else "0-0"

    def reaches_back_to(self, job_id: str, last: str) -> bool:
        """Whether nothing behind `last` has been dropped yet."""
        entries: Any = self._redis.xrange(stream_key(job_id), "-", last, count=1)
        return bool(entries)


def _event(entry_id: bytes, fields: dict[bytes, bytes]) -> Event:
    return Event(_text(entry_id), _text(fields[b"event"]), json.loads(fields[b"data"]))


def _text(value: bytes | str) -> str:
    return value.decode() if isinstance(value, bytes) else value
