"""The job record in Redis: our own truth, changed only here, atomically, and never backwards.

A worker's writes carry its lease ("attempt:holder"); a write under an old one is refused. Times are
those of Redis; no decision is taken by comparing clocks.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from redis import Redis
from redis.client import Pipeline

from service.events.store import EVENTS_KEPT, FEED_CHANNEL, stream_key
from service.jobs.index_store import (
    COUNTS_KEY,
    INDEX_PREFIX,
    LIVE_PREFIX,
    PARKED_KEY,
    QUEUE_PREFIX,
    RUNNING_PREFIX,
    JobIndex,
    idempotency_key,
    live_key,
    owner_key,
    queue_key,
    record_key,
    running_key,
    text_of,
)
from service.jobs.lease import Changed, Lease, Refused
from service.jobs.model import (
    RESULTS,
    TRANSITIONS,
    Artifact,
    Job,
    JobProgress,
    JobState,
    Preview,
    as_field,
    origins,
)
from service.jobs.scripts import CHANGE, CREATE, REMOVE, RENEW
from service.webhooks.store import DUE_KEY, log_key

EVERYWHERE = frozenset(TRANSITIONS)


@dataclass(frozen=True)
class Creation:
    """How a new record is to be written.

    queue_cap: queued jobs above which it is refused; 0: none
    owner_cap: jobs of its owner that have not ended, above which it is refused; 0: none
    idempotency_key, digest: the caller's word for this request, and what it stood for
    """

    queue_cap: int = 0
    owner_cap: int = 0
    idempotency_key: str = ""
    digest: str = ""


IDEMPOTENCY_SECONDS = 86_400


class JobStore(JobIndex):
    """Reads and atomic changes of job records. Safe to share between threads."""

    def __init__(self, redis: Redis, *, retention_seconds: float):
        super().__init__(redis)
        self._retention_ms = int(retention_seconds * 1000)
        self._create = redis.register_script(CREATE)
        self._change = redis.register_script(CHANGE)
        self._renew = redis.register_script(RENEW)
        self._remove = redis.register_script(REMOVE)

    def heed(self, lease: Lease) -> tuple[bool, str]:
        """Whether `lease` is still the one that counts, and the cancel flag."""
        found = self._redis.hmget(record_key(lease.job_id), ["state", "lease", "cancel"])
        state, token, cancel = (text_of(value or b"") for value in found)
        return (state, token) == (JobState.RUNNING, lease.token()), cancel

    # The life of a job

    def create(self, job: Job, creation: Creation, pipeline: Pipeline) -> None:
        """Write a new `queued` record within `pipeline`; `created` reads the answer."""
        given = {"id": job.id, "state": job.state, "attempt": job.attempt, "kind": job.kind,
                 "parent": job.parent, "queue": job.queue, "owner": job.owner, "label": job.label,
                 "options": dict(job.options), "result_attempt": 0, "beats": 0}  # fmt: skip
        if job.input is not None:
            given["input"] = asdict(job.input)
        if job.webhook:
            given["webhook"] = dict(job.webhook)
        name = creation.idempotency_key
        digest = creation.digest if name else ""
        self._create(
            keys=[record_key(job.id), stream_key(job.id), owner_key(job.owner),
                  idempotency_key(job.owner, name),
                  live_key(job.owner)],
            args=[job.id, fields_of(given), INDEX_PREFIX, FEED_CHANNEL, EVENTS_KEPT,
                  creation.queue_cap, self._retention_ms, digest,
                  IDEMPOTENCY_SECONDS * 1000, creation.owner_cap, queue_key(job.queue)],
            client=pipeline,
        )  # fmt: skip

    def remembered(self, owner: str, key: str) -> tuple[str, str] | None:
        """What an Idempotency-Key of this owner stands for: the request's digest, and its job."""
        digest, job_id = self._redis.hmget(idempotency_key(owner, key), ["digest", "job"])
        return None if digest is None else (text_of(digest), text_of(job_id))

    def start(self, lease: Lease, most: int = 0, *, anew: bool = True) -> Job:
        """`queued → running` under `lease`; refused unless this very attempt is waiting.

        most: jobs of its owner that may run at the same time, 0: any number. A job beyond them is
        refused as `waiting`, and parked.
        anew: what an attempt before told of itself is not true of this one; it is where this one
        goes on from there.
        """
        self._apply(
            lease.job_id,
            JobState.RUNNING,
            expect={"attempt": str(lease.attempt)},
            fields={"lease": lease.token(), "beats": 0}
            | ({"progress": None, "preview": None} if anew else {}),
            most=most,
        )
        job = self.get(lease.job_id)
        if job is None:
            raise Refused("missing", None)
        return job

    def progress(self, lease: Lease, progress: JobProgress) -> Changed:
        """Note a report of the running job."""
        told = asdict(progress)
        return self._apply(
            lease.job_id, None, expect={"lease": lease.token()}, fields={"progress": told},
            allowed=frozenset({JobState.RUNNING}), event="progress", data=told,
        )  # fmt: skip

    def preview(self, lease: Lease, preview: Preview) -> Changed:
        """Tell of a mesh of the unfinished fit, which is in the artefact store."""
        told = asdict(preview)
        return self._apply(
            lease.job_id, None, expect={"lease": lease.token()}, fields={"preview": told},
            allowed=frozenset({JobState.RUNNING}), event="preview",
            data=told | {"href": f"/jobs/{lease.job_id}/preview.glb"},
        )  # fmt: skip

    def renew(self, lease: Lease) -> tuple[bool, str]:
        """Move the lease's beat on. Says whether the lease still counts, and the cancel flag."""
        reply = [text_of(part) for part in self._renew(
            keys=[record_key(lease.job_id)], args=[lease.job_id, lease.token()]
        )]  # fmt: skip
        return reply[0] == "ok", reply[1] if len(reply) > 1 else ""

    def succeed(self, lease: Lease, artifacts: Mapping[str, Artifact]) -> Changed:
        """`running → succeeded`: from here on this attempt's files are the job's result."""
        files = {name: asdict(about) for name, about in artifacts.items()}
        fields = {"artifacts": files, "result_attempt": lease.attempt, "lease": ""}
        return self._apply(
            lease.job_id, JobState.SUCCEEDED, expect={"lease": lease.token()}, fields=fields
        )

    def fail(self, lease: Lease, problem: Mapping[str, Any]) -> Changed:
        """`running → failed` with the problem to show."""
        return self._end(lease.job_id, JobState.FAILED, {"lease": lease.token()}, problem)

    def cancelled(self, lease: Lease, problem: Mapping[str, Any]) -> Changed:
        """`running → cancelled`: the run has stopped because it was asked to."""
        return self._end(lease.job_id, JobState.CANCELLED, {"lease": lease.token()}, problem)

    def hand_back(self, lease: Lease) -> Changed:
        """`running → queued` as the next attempt; the caller enqueues it."""
        return self._requeue(lease.job_id, {"lease": lease.token()})

    def reap(self, job: Job) -> Changed:
        """As `hand_back`, for a lease whose beats have stopped since `job` was read."""
        return self._requeue(job.id, _as_seen(job))

    def reap_failed(self, job: Job, problem: Mapping[str, Any]) -> Changed:
        """As `reap`, but there are no attempts left."""
        return self._end(job.id, JobState.FAILED, _as_seen(job), problem)

    def reap_cancelled(self, job: Job, problem: Mapping[str, Any]) -> Changed:
        """As `reap`, but the job had been asked to stop."""
        return self._end(job.id, JobState.CANCELLED, _as_seen(job), problem)

    def ask_cancel(self, job_id: str, how: str, problem: Mapping[str, Any]) -> Changed:
        """Cancel a job that no worker has at once; ask a running one to stop. An ended one is
        refused.

        how: "discard", or "keep" to have the surface so far as the result: there is something of it
        where a job was split.
        """
        try:
            return self._apply(
                job_id, JobState.CANCELLED,
                expect={"lease": ""} | ({"split": ""} if how == "keep" else {}),
                fields={"problem": dict(problem), "cancel": how},
            )  # fmt: skip
        except Refused as refusal:
            if refusal.reason != "fenced":
                raise
        return self._apply(
            job_id, None, expect={}, fields={"cancel": how},
            allowed=frozenset({JobState.QUEUED, JobState.RUNNING}),
            event="cancel", data={"cancel": how},
        )  # fmt: skip

    def expire(self, job_id: str, problem: Mapping[str, Any]) -> Changed:
        """An ended job's files are removed; its record stays to say so."""
        fields = {"problem": dict(problem), "artifacts": {}, "result_attempt": 0}
        return self._apply(job_id, JobState.EXPIRED, expect={}, fields=fields)

    def park(self, job_id: str) -> None:
        """Let a queued job wait for others of its owner, without an entry in RQ."""
        self._redis.sadd(PARKED_KEY, job_id)

    def unpark(self, job_id: str) -> bool:
        """Whether this call, and none before, took the job out again."""
        return bool(self._redis.srem(PARKED_KEY, job_id))

    def remove(self, job: Job) -> bool:
        """Forget the job altogether. Says whether there was one."""
        reply = self._remove(
            keys=[
                record_key(job.id),
                stream_key(job.id),
                owner_key(job.owner),
                live_key(job.owner),
                log_key(job.id),
                running_key(job.owner),
                PARKED_KEY,
                queue_key(job.queue),
            ],
            args=[job.id, INDEX_PREFIX, FEED_CHANNEL],
        )
        return text_of(reply[0]) == "ok"

    # One way in for all changes

    def _end(
        self, job_id: str, state: JobState, expect: Mapping[str, str], problem: Mapping[str, Any]
    ) -> Changed:
        fields = {"problem": dict(problem), "lease": ""}
        return self._apply(job_id, state, expect=expect, fields=fields)

    def _requeue(self, job_id: str, expect: Mapping[str, str]) -> Changed:
        return self._apply(
            job_id, JobState.QUEUED, expect=expect, fields={"lease": ""}, next_attempt=True
        )

    def _apply(
        self,
        job_id: str,
        target: JobState | None,
        *,
        expect: Mapping[str, str],
        fields: Mapping[str, Any],
        allowed: frozenset[JobState] | None = None,
        next_attempt: bool = False,
        most: int = 0,
        event: str = "",
        data: Mapping[str, Any] | None = None,
    ) -> Changed:
        sources = origins(target) if target is not None else (allowed or frozenset())
        if target is not None:
            event = "state"
            data = {"state": target} | {k: v for k, v in fields.items() if k == "problem"}
        args = [
            job_id, json.dumps(expect), f",{','.join(sorted(sources))},", target or "",
            fields_of(fields), _STAMPS.get(target, "") if target else "", int(next_attempt), event,
            json.dumps(data or {}, allow_nan=False), INDEX_PREFIX, FEED_CHANNEL, EVENTS_KEPT,
            self._retention_ms if target in RESULTS else 0, LIVE_PREFIX,
            COUNTS_KEY,
            DUE_KEY,
            RUNNING_PREFIX,
            most,
            PARKED_KEY,
            QUEUE_PREFIX,
        ]  # fmt: skip
        reply = self._change(keys=[record_key(job_id), stream_key(job_id)], args=args)
        return changed_by(reply)


_STAMPS = {
    JobState.QUEUED: "queued_at",
    JobState.RUNNING: "started_at",
    JobState.SUCCEEDED: "finished_at",
    JobState.FAILED: "finished_at",
    JobState.CANCELLED: "finished_at",
    # It may come early, for want of room.
    JobState.EXPIRED: "expires_at",
}


def _as_seen(job: Job) -> dict[str, str]:
    """What must still hold for a lease to be taken away: nobody renewed it since."""
    return {"lease": job.lease, "beats": str(job.beats)}


def created(reply: Any) -> None:
    """Raise Refused unless the answer of `create` says that the record was written."""
    verdict, *rest = [text_of(part) for part in reply]
    if verdict != "ok":
        raise Refused(verdict, job_id=rest[0] if rest else "")


def changed_by(reply: Any) -> Changed:
    """What a script answered to a change; raises Refused."""
    verdict, *rest = [text_of(part) for part in reply]
    if verdict != "ok":
        raise Refused(verdict, JobState(rest[0]) if rest else None)
    return Changed(JobState(rest[0]), int(rest[1]), rest[2])


def fields_of(values: Mapping[str, Any]) -> str:
    """Fields of a record as the scripts take them: a JSON object of strings."""
    return json.dumps({name: as_field(value) for name, value in values.items()})
