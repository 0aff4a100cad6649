"""RQ as transport: it carries job ids to workers and may forget them; the record decides.

The entry's id is `jobid-attempt`; its only argument is the job's id, in JSON (RQ's default, pickle,
would let whoever writes to Redis run code).
"""

from __future__ import annotations

from redis import Redis
from redis.client import Pipeline
from rq import Queue
from rq.exceptions import NoSuchJobError
from rq.job import Job as Entry
from rq.serializers import JSONSerializer

QUEUE_NAME = "mpf"
TASK = "worker.tasks.run"
# RQ's own notes about an ended entry are of no use to us; it may drop them soon.
ENDED_ENTRY_SECONDS = 60


def entry_id(job_id: str, attempt: int) -> str:
    """RQ's id of one attempt at a job."""
    return f"{job_id}-{attempt}"


def attempt_of(entry: str) -> tuple[str, int]:
    """The job's id and attempt number that an entry's id carries."""
    job_id, _, attempt = entry.rpartition("-")
    return job_id, int(attempt)


class JobQueue:
    """The one queue, in order of arrival."""

    def __init__(self, redis: Redis, *, job_seconds: float):
        self._redis = redis
        self._job_seconds = job_seconds
        self._queue = Queue(QUEUE_NAME, connection=redis, serializer=JSONSerializer)

    def enqueue(self, job_id: str, attempt: int, pipeline: Pipeline | None = None) -> None:
        """Let a worker know of this attempt; within `pipeline`, when that is executed."""
        self._queue.enqueue_call(
            TASK,
            args=(job_id,),
            job_id=entry_id(job_id, attempt),
            timeout=int(self._job_seconds),
            result_ttl=ENDED_ENTRY_SECONDS,
            failure_ttl=ENDED_ENTRY_SECONDS,
            description=entry_id(job_id, attempt),
            pipeline=pipeline,
        )

    def waiting(self) -> set[str]:
        """Ids of the entries that no worker has taken."""
        return set(self._queue.get_job_ids())

    def withdraw(self, job_id: str, attempt: int) -> None:
        """Take the entry out again, if it is still there."""
        try:
            entry = Entry.fetch(
                entry_id(job_id, attempt), connection=self._redis, serializer=JSONSerializer
            )
        except NoSuchJobError:
            return
        self._queue.remove(entry.id)
        entry.delete()
