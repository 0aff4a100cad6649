"""Reading job records and the indexes over them; the names of their keys."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from redis import Redis

from service.jobs.model import Job, JobState, job_from_record
from service.settings import QUEUES

INDEX_PREFIX = "mpf:jobs:in:"
ENDED_INDEX = INDEX_PREFIX + "ended"
"""Ended jobs by the time at which they expire."""


COUNTS_KEY = "mpf:counts"
"""Ended jobs by state and code, and the time they ran, since this Redis was first used."""


RECORD_PREFIX = "mpf:job:"


def record_key(job_id: str) -> str:
    """The hash that holds a job's record."""
    return RECORD_PREFIX + job_id


QUEUE_PREFIX = "mpf:jobs:waiting:"


def queue_key(queue: str) -> str:
    """The queued jobs of one queue, by the time at which they came."""
    return QUEUE_PREFIX + queue


def owner_key(owner: str) -> str:
    """The jobs of one owner by the time of their creation."""
    return f"mpf:jobs:of:{owner}"


LIVE_PREFIX = "mpf:jobs:live:"


def live_key(owner: str) -> str:
    """The jobs of one owner that have not ended."""
    return LIVE_PREFIX + owner


RUNNING_PREFIX = "mpf:jobs:running:"


def running_key(owner: str) -> str:
    """The jobs of one owner that run."""
    return RUNNING_PREFIX + owner


PARKED_KEY = "mpf:jobs:parked"
"""Queued jobs without an entry in RQ, since their owner runs as many as it may."""


def idempotency_key(owner: str, key: str) -> str:
    """What an owner's Idempotency-Key stands for."""
    return f"mpf:idempotency:{owner}:{key}"


@dataclass(frozen=True)
class Place:
    """A place in an owner's list: jobs listed after it are older."""

    created_at: int
    job_id: str


class JobIndex:
    """Reads only."""

    def __init__(self, redis: Redis):
        self._redis = redis

    def get(self, job_id: str) -> Job | None:
        """The job, or None."""
        record = self._redis.hgetall(record_key(job_id))
        return _job(record) if record else None

    def in_state(self, state: JobState) -> list[str]:
        """Ids of the jobs in `state`, the longest there first."""
        return [text_of(job_id) for job_id in self._redis.zrange(INDEX_PREFIX + state, 0, -1)]

    def count(self, state: JobState) -> int:
        """How many jobs are in `state`."""
        return int(self._redis.zcard(INDEX_PREFIX + state))

    def position(self, job: Job) -> int | None:
        """How many jobs are before this one in its queue, or None if it is not queued."""
        rank: Any = self._redis.zrank(queue_key(job.queue), job.id)
        return None if rank is None else int(rank)

    def waiting(self, queue: str) -> int:
        """How many jobs wait in this queue."""
        return int(self._redis.zcard(queue_key(queue)))

    def oldest_queued_seconds(self, queue: str | None = None) -> float:
        """For how long the first job of the queue, or of all queues, has waited."""
        key = INDEX_PREFIX + JobState.QUEUED if queue is None else queue_key(queue)
        first: Any = self._redis.zrange(key, 0, 0, withscores=True)
        return max(0.0, self.now() - float(first[0][1]) / 1000) if first else 0.0

    def due(self, most: int) -> list[str]:
        """Ended jobs whose time to expire has come."""
        found = self._redis.zrange(
            ENDED_INDEX, "-inf", int(self.now() * 1000), byscore=True, offset=0, num=most
        )
        return [text_of(job_id) for job_id in found]

    def first_to_expire(self, most: int) -> list[str]:
        """Ended jobs, those that expire first before the others."""
        return [text_of(job_id) for job_id in self._redis.zrange(ENDED_INDEX, 0, most - 1)]

    def newest_first(self, owner: str, after: Place | None, batch: int) -> Iterator[Job]:
        """The jobs of `owner`, newest first, from behind `after` on; read in batches."""
        top: int | str = "+inf" if after is None else after.created_at
        offset = 0
        while True:
            found = self._redis.zrange(
                owner_key(owner), top, "-inf",
                desc=True, byscore=True, offset=offset, num=batch,
            )  # fmt: skip
            for job in self._many([text_of(job_id) for job_id in found]):
                if after is None or (job.created_at, job.id) < (after.created_at, after.job_id):
                    yield job
            if len(found) < batch:
                return
            offset += batch

    def counts(self) -> dict[str, int]:
        """`COUNTS_KEY` as it stands: "state code" → jobs, and "run_milliseconds"."""
        found = self._redis.hgetall(COUNTS_KEY)
        return {text_of(name): int(value) for name, value in found.items()}

    def running(self) -> list[Job]:
        """The jobs that run now."""
        return list(self._many(self.in_state(JobState.RUNNING)))

    def running_of(self, owner: str) -> int:
        """How many jobs of this owner run now."""
        return int(self._redis.scard(running_key(owner)))

    def parked(self) -> list[Job]:
        """The jobs that wait for others of their owner, the oldest first."""
        found = self._many([text_of(job_id) for job_id in self._redis.smembers(PARKED_KEY)])
        return sorted(found, key=lambda job: job.created_at)

    def now(self) -> float:
        """The clock of Redis, s since 1970."""
        seconds, microseconds = self._redis.time()
        return float(seconds) + float(microseconds) / 1e6

    def _many(self, job_ids: list[str]) -> Iterator[Job]:
        with self._redis.pipeline(transaction=False) as pipeline:
            for job_id in job_ids:
                pipeline.hgetall(record_key(job_id))
            yield from (_job(record) for record in pipeline.execute() if record)


Looked = tuple[Job | None, int | None]
"""A job, and how many jobs are before it in its queue (None unless it is queued itself)."""

QUESTIONS = 1 + len(QUEUES)


def ask(pipeline: Any, job_id: str) -> None:
    """Put the QUESTIONS of `looked` into a pipeline, of either kind of client."""
    pipeline.hgetall(record_key(job_id))
    for queue in QUEUES:  # its queue stands in the record, which is on its way
        pipeline.zrank(queue_key(queue), job_id)


def looked(record: Any, *ranks: Any) -> Looked:
    """What the answers to `ask` say."""
    found = [int(rank) for rank in ranks if rank is not None]
    return (_job(record) if record else None), (found[0] if found else None)


def _job(record: Any) -> Job:
    return job_from_record({text_of(k): text_of(v) for k, v in record.items()})


def text_of(value: Any) -> str:
    """What Redis holds is UTF-8."""
    return value.decode() if isinstance(value, bytes) else str(value)
