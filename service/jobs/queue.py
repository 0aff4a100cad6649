"""RQ as transport: it carries job ids to workers and may forget them; the record decides.

There is a queue for each weight of work, so that what takes seconds never waits behind what takes
hours. The entry's id is `jobid-attempt`; its only argument is the job's id, in JSON (RQ's default,
pickle, would let whoever writes to Redis run code).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from redis import Redis
from redis.client import Pipeline
from rq import Queue
from rq.exceptions import NoSuchJobError
from rq.job import Job as Entry
from rq.serializers import JSONSerializer

from service.jobs.model import EXTRACTION, Input, Job
from service.settings import EXTRACT as EXTRACT_QUEUE
from service.settings import FIT_LARGE, FIT_SMALL, QUEUES, Settings

TASK = "worker.tasks.run"
# RQ's own notes about an ended entry are of no use to us; it may drop them soon.
ENDED_ENTRY_SECONDS = 60


def rq_name(queue: str) -> str:
    """What RQ calls one of our queues."""
    return f"mpf-{queue}"


def queue_for(
    kind: str, options: Mapping[str, Any], given: Input | None, settings: Settings
) -> str:
    """The queue of a job: by its kind, by the points that its fit evaluates, by its cloud.

    Options that are not named count as nothing, an uncounted cloud as a small one.
    """
    if kind == EXTRACTION:
        return EXTRACT_QUEUE
    step = sum(int(options.get(f"{place}_points") or 0) for place in ("surface", "near", "far"))
    evaluations = step * int(options.get("max_iterations") or 0)
    points = given.points or 0 if given is not None else 0
    large = evaluations > settings.large_fit_evaluations or points > settings.large_fit_points
    return FIT_LARGE if large else FIT_SMALL


def entry_id(job_id: str, attempt: int) -> str:
    """RQ's id of one attempt at a job."""
    return f"{job_id}-{attempt}"


def attempt_of(entry: str) -> tuple[str, int]:
    """The job's id and attempt number that an entry's id carries."""
    job_id, _, attempt = entry.rpartition("-")
    return job_id, int(attempt)


class JobQueue:
    """The queues, each in order of arrival."""

    def __init__(self, redis: Redis, *, job_seconds: float):
        self._redis = redis
        self._job_seconds = job_seconds
        self._queues: dict[str, Queue] = {
            name: Queue(rq_name(name), connection=redis, serializer=JSONSerializer)
            for name in QUEUES
        }

    def enqueue(self, job: Job, attempt: int, pipeline: Pipeline | None = None) -> None:
        """Let a worker know of this attempt; within `pipeline`, when that is executed.

        A job whose tiles are fitted has waited already: it goes before the others.
        """
        # A record of earlier software names no queue.
        queue = self._queues.get(job.queue) or self._queues[FIT_SMALL]
        queue.enqueue_call(
            TASK,
            args=(job.id,),
            job_id=entry_id(job.id, attempt),
            timeout=int(self._job_seconds),
            result_ttl=ENDED_ENTRY_SECONDS,
            failure_ttl=ENDED_ENTRY_SECONDS,
            description=entry_id(job.id, attempt),
            pipeline=pipeline,
            at_front=bool(job.split),
        )

    def waiting(self) -> set[str]:
        """Ids of the entries that no worker has taken."""
        return {entry for queue in self._queues.values() for entry in queue.get_job_ids()}

    def withdraw(self, job_id: str, attempt: int) -> None:
        """Take the entry out again, if it is still there."""
        try:
            entry = Entry.fetch(
                entry_id(job_id, attempt), connection=self._redis, serializer=JSONSerializer
            )
        except NoSuchJobError:
            return
        for queue in self._queues.values():
            queue.remove(entry.id)
        entry.delete()
