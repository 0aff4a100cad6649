"""What a caller can do to jobs: each method is one act, over record, queue and files."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

from redis import Redis

from mpf_core.extraction_options import extraction_from, extraction_to_mapping
from mpf_core.options import options_from, options_to_mapping
from service.access.caller import Caller
from service.artifacts.base import Artifacts, StoreUnavailable
from service.jobs.family import Families, cancelled_problem
from service.jobs.index_store import Place
from service.jobs.lease import Refused
from service.jobs.model import EXTRACTION, FIT, TILE, Job, JobState, new_job_id
from service.jobs.queue import JobQueue, queue_for
from service.jobs.store import Creation, created
from service.jobs.tile_store import TileStore
from service.jobs.tiles import require_few
from service.problems import Problem
from service.settings import Settings

LOOKED_AT = 2000
"""Records that one page of a filtered list looks at before it ends early, with a cursor."""


@dataclass(frozen=True)
class Filter:
    """Which jobs to list."""

    states: frozenset[JobState] = frozenset(JobState)
    label: str | None = None

    def admits(self, job: Job) -> bool:
        """Whether `job` belongs in the list."""
        return job.state in self.states and self.label in (None, job.label)


@dataclass(frozen=True)
class Page:
    """Jobs, newest first, and where the next page starts."""

    jobs: tuple[Job, ...]
    next: Place | None


class JobCommands:
    """The desk at which requests become changes. Another's job is as good as none."""

    def __init__(
        self,
        redis: Redis,
        store: TileStore,
        queue: JobQueue,
        artifacts: Artifacts,
        settings: Settings,
    ):
        self._redis = redis
        self._store = store
        self._queue = queue
        self._artifacts = artifacts
        self._settings = settings
        self._families = Families(store, queue, artifacts)

    # Reading

    def get(self, caller: Caller, job_id: str) -> Job:
        """The job; raises Problem `job.not_found` or `job.expired`."""
        return visible(self._store.get(job_id), caller, job_id)

    def position(self, job: Job) -> int | None:
        """Jobs before this one in its queue."""
        return self._store.position(job) if job.state is JobState.QUEUED else None

    def page(self, caller: Caller, wanted: Filter, after: Place | None, size: int) -> Page:
        """The caller's jobs behind `after`, newest first."""
        found: list[Job] = []
        last: Job | None = None
        jobs = self._store.newest_first(caller.owner, after, batch=max(50, size))
        for last in islice(jobs, LOOKED_AT):
            if wanted.admits(last):
                found.append(last)
            if len(found) == size:
                break
        else:
            if last is None or next(jobs, None) is None:
                return Page(tuple(found), None)
        return Page(tuple(found), Place(last.created_at, last.id) if last else None)

    def result_of(self, caller: Caller, job_id: str) -> Job:
        """The job, if it has a result; raises Problem if it has none."""
        job = self.get(caller, job_id)
        if not job.result_attempt:
            raise no_result(job)
        return job

    def artifact_of(self, caller: Caller, job_id: str, name: str) -> Job:
        """The job that has published a file of this name; raises Problem if it has none."""
        job = self.result_of(caller, job_id)
        if name not in job.artifacts:
            raise Problem("artifact.not_found", f"job {job_id} has no {name}")
        return job

    def preview_of(self, caller: Caller, job_id: str) -> bytes:
        """The latest mesh of the unfinished fit; raises Problem if there is none."""
        job = self.get(caller, job_id)
        try:
            if job.shown is not None:
                return self._artifacts.read_preview(job.id, job.shown.attempt)
        except FileNotFoundError:
            pass  # the attempt has ended since
        if job.ended:
            raise Problem("artifact.not_found", f"job {job_id} has no preview any more",
                          advice="Its result is final, if it has one.")  # fmt: skip
        raise Problem("job.not_ready", f"job {job_id} has no preview yet", retry_after=5)

    # Changing

    def cancel(self, caller: Caller, job_id: str, *, keep: bool) -> Job:
        """Ask a job to stop; an ended one stays as it is.

        keep: have the surface so far as the result, if it is running.
        """
        self.get(caller, job_id)
        how = "keep" if keep else "discard"
        try:
            changed = self._store.ask_cancel(job_id, how, cancelled_problem())
        except Refused as refusal:
            if refusal.reason == "missing":
                raise not_found(job_id) from refusal
        else:
            if changed.state is JobState.CANCELLED:
                self._queue.withdraw(job_id, changed.attempt)
                with suppress(StoreUnavailable):  # they go with the job
                    self._artifacts.forget_checkpoints(job_id)
        self._families.look(job_id, files=False)  # its tiles, should it have any
        return self.get(caller, job_id)

    def delete(self, caller: Caller, job_id: str) -> None:
        """Remove the job and its files; a running one loses its lease and is killed."""
        job = self._store.get(job_id)
        if job is None or not _belongs(job, caller):
            raise not_found(job_id)
        self._store.remove(job)
        self._queue.withdraw(job.id, job.attempt)
        self._families.look(job.id, files=False)
        with suppress(StoreUnavailable):  # files without a record are removed later, by age
            self._artifacts.remove(job.id)

    def retry(
        self,
        caller: Caller,
        job_id: str,
        changes: Mapping[str, Any],
        label: str,
        idempotency_key: str = "",
    ) -> Job:
        """A new job on the same input, with some options changed."""
        parent = self.get(caller, job_id)
        merged = _merged(parent, changes)
        if parent.kind == FIT and parent.input is not None:
            few = self._settings.tiles_per_job
            require_few(parent.input.points, options_from(merged), few)
        job = Job(
            id=new_job_id(),
            state=JobState.QUEUED,
            attempt=1,
            kind=parent.kind,
            parent=parent.id,
            owner=caller.owner,
            label=label or parent.label,
            options=merged,
            input=parent.input,
        )
        self.require_room()
        try:
            self._artifacts.share_input(parent.id, job.id)
        except FileNotFoundError as error:
            raise not_found(job_id) from error
        digest = digest_of("retry", job_id, dict(changes), label)
        return self.accept(job, idempotency_key=idempotency_key, digest=digest)

    def repeated(self, caller: Caller, idempotency_key: str, digest: str) -> Job | None:
        """The job that this very request became before; raises Problem if it was another one."""
        before = self._store.remembered(caller.owner, idempotency_key) if idempotency_key else None
        if before is None:
            return None
        if before[0] != digest:
            raise _conflict(before[1])
        return self.get(caller, before[1])

    def require_room(self) -> None:
        """Raise Problem `queue.full` or `storage.full` if a new job has no chance."""
        if self._store.count(JobState.QUEUED) >= self._settings.queue_length:
            raise _full()
        if self._artifacts.free_fraction() < self._settings.disk_low_fraction:
            raise Problem("storage.full", "the disk of the service is nearly full", retry_after=60)

    def accept(self, job: Job, *, idempotency_key: str = "", digest: str = "") -> Job:
        """Write the record and its queue entry in one transaction: both or neither.

        The input must be in the store. Answers the job that was accepted before if this very
        request was.
        """
        queue = queue_for(job.kind, job.options, job.input, self._settings)
        job = replace(job, queue=queue)
        creation = Creation(
            self._settings.queue_length, self._settings.jobs_per_owner, idempotency_key, digest
        )
        try:
            with self._redis.pipeline(transaction=True) as pipeline:
                pipeline.multi()
                self._store.create(job, creation, pipeline)
                self._queue.enqueue(job, job.attempt, pipeline)
                replies = pipeline.execute()
            created(replies[0])
        except Refused as refusal:
            self._queue.withdraw(job.id, job.attempt)
            with suppress(StoreUnavailable):
                self._artifacts.remove(job.id)
            return self._refused(job, refusal)
        # Not on other errors: Redis may have taken the job before the answer was lost. Files
        # without a record are removed later, by age.
        return self.get(Caller(job.owner), job.id)

    def _refused(self, job: Job, refusal: Refused) -> Job:
        if refusal.reason == "repeated":
            return self.get(Caller(job.owner), refusal.job_id)
        if refusal.reason == "conflict":
            raise _conflict(refusal.job_id)
        if refusal.reason == "quota":
            raise Problem(
                "quota.jobs", f"{self._settings.jobs_per_owner} of your jobs have not ended",
                advice="Wait for one of them, or cancel one.", retry_after=30,
            )  # fmt: skip
        raise _full()


def visible(job: Job | None, caller: Caller, job_id: str) -> Job:
    """The job as this caller may see it; raises Problem if that is not at all."""
    if job is None or not _belongs(job, caller):
        raise not_found(job_id)
    if job.state is JobState.EXPIRED:
        raise expired(job_id)
    return job


def _belongs(job: Job, caller: Caller) -> bool:
    """Whether the job is one of the caller's; a tile is a part of one, and none by itself."""
    return job.owner == caller.owner and job.kind != TILE


def _merged(parent: Job, changes: Mapping[str, Any]) -> dict[str, Any]:
    """The parent's options with some replaced; a new preset starts from that preset."""
    if parent.kind == EXTRACTION:
        return extraction_to_mapping(extraction_from(dict(parent.options) | dict(changes)))
    base = {} if "preset" in changes else dict(parent.options)
    return options_to_mapping(options_from(base | dict(changes)))


def digest_of(*request: Any) -> str:
    """What makes two requests without a file the same."""
    return hashlib.sha256(json.dumps(request, sort_keys=True).encode()).hexdigest()


def not_found(job_id: str) -> Problem:
    """The problem of an id that is nobody's, or another's."""
    return Problem("job.not_found", f"there is no job {job_id}")


def expired(job_id: str) -> Problem:
    """The problem of a job whose time was over."""
    return Problem("job.expired", f"job {job_id} has expired; its files are removed")


def no_result(job: Job) -> Problem:
    """The problem of a job that has no files to give."""
    if job.ended:
        return Problem("job.no_result", f"job {job.id} is {job.state}",
                       advice=f"GET /jobs/{job.id} says why.")  # fmt: skip
    return Problem("job.not_ready", f"job {job.id} is {job.state}", retry_after=2)


def _conflict(job_id: str) -> Problem:
    return Problem(
        "idempotency.conflict",
        f"this Idempotency-Key stands for another request, which became job {job_id}",
        where="Idempotency-Key",
        advice="Use a new key for a new request.",
    )


def _full() -> Problem:
    return Problem("queue.full", "too many jobs are waiting", retry_after=60)
