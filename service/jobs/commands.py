"""What a caller can do to jobs: each method is one act, over record, queue and files."""

from __future__ import annotations

import secrets

from redis import Redis

from mpf_core.options import options_from, options_to_mapping
from service.artifacts.store import ArtifactStore
from service.jobs.model import Input, Job, JobState
from service.jobs.queue import JobQueue
from service.jobs.store import JobStore, Refused, created
from service.problems import Problem
from service.settings import Settings
from service.uploads.check import check_content
from service.uploads.receive import Submission


class JobCommands:
    """The desk at which requests become changes."""

    def __init__(
        self,
        redis: Redis,
        store: JobStore,
        queue: JobQueue,
        artifacts: ArtifactStore,
        settings: Settings,
    ):
        self._redis = redis
        self._store = store
        self._queue = queue
        self._artifacts = artifacts
        self._settings = settings

    def submit(self, submission: Submission) -> Job:
        """A new queued job; when this returns, input and record are on disk."""
        stored = submission.stored
        try:
            chosen = options_to_mapping(options_from(submission.options()))
            self._require_room()
            points = check_content(stored, self._settings)
            job = Job(
                id=secrets.token_hex(16),
                state=JobState.QUEUED,
                attempt=1,
                options=chosen,
                input=Input(stored.name, stored.header.format, stored.bytes, stored.sha256, points),
            )
            self._artifacts.adopt_input(job.id, stored.path, stored.header.format)
        finally:
            stored.path.unlink(missing_ok=True)
        return self._accept(job)

    def get(self, job_id: str) -> Job:
        """The job; raises Problem `job.not_found`."""
        job = self._store.get(job_id)
        if job is None:
            raise not_found(job_id)
        return job

    def position(self, job: Job) -> int | None:
        """Jobs before this one in the queue."""
        return self._store.position(job.id) if job.state is JobState.QUEUED else None

    def cancel(self, job_id: str) -> Job:
        """Ask a job to stop; an ended one stays as it is."""
        problem = Problem("cancelled", "the job was cancelled by its owner").as_dict()
        try:
            changed = self._store.ask_cancel(job_id, problem)
        except Refused as refusal:
            if refusal.reason == "missing":
                raise not_found(job_id) from refusal
        else:
            if changed.state is JobState.CANCELLED:
                self._queue.withdraw(job_id, changed.attempt)
        return self.get(job_id)

    def artifact_of(self, job_id: str, name: str) -> tuple[Job, str]:
        """The job and the name of its published file; raises Problem if there is none."""
        job = self.get(job_id)
        if not job.result_attempt:
            raise _no_result(job)
        if name not in job.artifacts:
            raise Problem("artifact.not_found", f"job {job_id} has no {name}")
        return job, name

    def _require_room(self) -> None:
        if self._store.count(JobState.QUEUED) >= self._settings.queue_length:
            raise _full()

    def _accept(self, job: Job) -> Job:
        """Write the record and its queue entry in one transaction: both or neither."""
        try:
            with self._redis.pipeline(transaction=True) as pipeline:
                pipeline.multi()
                self._store.create(job, queue_cap=self._settings.queue_length, pipeline=pipeline)
                self._queue.enqueue(job.id, job.attempt, pipeline)
                replies = pipeline.execute()
            created(replies[0])
        except Refused as refusal:
            self._queue.withdraw(job.id, job.attempt)
            self._artifacts.remove(job.id)
            raise _full() from refusal
        # Not on other errors: Redis may have taken the job before the answer was lost. Files
        # without a record are removed later, by age.
        return self.get(job.id)


def not_found(job_id: str) -> Problem:
    """The problem of an id that is nobody's, or another's."""
    return Problem("job.not_found", f"there is no job {job_id}")


def _full() -> Problem:
    return Problem("queue.full", "too many jobs are waiting", retry_after=60)


def _no_result(job: Job) -> Problem:
    if job.ended:
        return Problem("job.no_result", f"job {job.id} is {job.state}",
                       advice=f"GET /jobs/{job.id} says why.")  # fmt: skip
    return Problem("job.not_ready", f"job {job.id} is {job.state}", retry_after=2)
