"""The record: the table of states holds in Redis, and an old attempt cannot write any more."""

from __future__ import annotations

import itertools

import pytest
from redis import Redis

from service.artifacts.store import ArtifactStore
from service.jobs.index_store import INDEX_PREFIX, record_key
from service.jobs.lease import Lease, Refused
from service.jobs.model import TRANSITIONS, Job, JobProgress, JobState, new_job_id
from service.jobs.queue import JobQueue, entry_id
from service.jobs.store import Creation, JobStore
from service.jobs.tile_store import TileStore
from service.operations.store import Turns, WorkerRegister
from service.settings import Settings
from worker.reaper import LOST_ENTRY_SECONDS, Reaper

PROBLEM = {"code": "cancelled"}


@pytest.fixture
def store(redis: Redis) -> TileStore:
    return TileStore(redis, retention_seconds=100.0)


def queued(store: JobStore, redis: Redis) -> str:
    job = Job(id=new_job_id(), state=JobState.QUEUED, attempt=1)
    with redis.pipeline() as pipeline:
        store.create(job, Creation(), pipeline)
        pipeline.execute()
    return job.id


def put(store: JobStore, redis: Redis, state: JobState) -> Lease:
    """A job that stands in `state`, however it came there."""
    job_id = queued(store, redis)
    lease = Lease(job_id, 1, "a")
    if state is not JobState.QUEUED:
        store.start(lease)
        redis.hset(record_key(job_id), "state", state)
        redis.zrem(INDEX_PREFIX + JobState.RUNNING, job_id)
        redis.zadd(INDEX_PREFIX + state, {job_id: 1})
    return lease


@pytest.mark.parametrize(("source", "target"), itertools.product(JobState, JobState))
def test_only_legal_changes_are_made(
    store: JobStore, redis: Redis, source: JobState, target: JobState
) -> None:
    lease = put(store, redis, source)
    token = {"lease": lease.token()} if source is not JobState.QUEUED else {}
    # The one way in for all changes, with everything right but the states.
    legal = target in TRANSITIONS[source]
    if legal:
        assert store._apply(lease.job_id, target, expect=token, fields={}).state is target
        assert store.in_state(source) == []
    else:
        with pytest.raises(Refused) as refusal:
            store._apply(lease.job_id, target, expect=token, fields={})
        assert (refusal.value.reason, refusal.value.state) == ("illegal", source)
    now = target if legal else source
    job = store.get(lease.job_id)
    assert job is not None
    assert job.state is now
    assert store.in_state(now) == [lease.job_id]


def test_an_old_attempt_cannot_write_any_more(store: JobStore, redis: Redis) -> None:
    job_id = queued(store, redis)
    old = Lease(job_id, 1, "a")
    store.start(old)
    seen = store.get(job_id)
    assert seen is not None
    store.reap(seen)
    new = Lease(job_id, 2, "b")
    store.start(new)
    before = redis.hgetall(record_key(job_id))
    for write in (
        lambda: store.succeed(old, {}),
        lambda: store.fail(old, PROBLEM),
        lambda: store.cancelled(old, PROBLEM),
        lambda: store.hand_back(old),
        lambda: store.progress(old, JobProgress("fit", 0.5, 1.0)),
        lambda: store.start(old),
        lambda: store.reap(seen),
    ):
        with pytest.raises(Refused):
            write()
    assert store.renew(old) == (False, "")
    assert redis.hgetall(record_key(job_id)) == before
    assert store.succeed(new, {}).attempt == 2


def test_a_beat_between_look_and_reaping_saves_the_job(store: JobStore, redis: Redis) -> None:
    lease = put(store, redis, JobState.RUNNING)
    seen = store.get(lease.job_id)
    assert seen is not None
    assert store.renew(lease)[0]
    with pytest.raises(Refused) as refusal:
        store.reap(seen)
    assert refusal.value.reason == "fenced"


def test_a_queued_job_that_the_queue_forgot_is_enqueued_again(
    store: TileStore, redis: Redis, settings: Settings
) -> None:
    job_id = queued(store, redis)
    queue = JobQueue(redis, job_seconds=10)
    now = [0.0]
    artifacts = ArtifactStore(settings.data_dir)
    reaper = Reaper(
        store, queue, artifacts, settings, WorkerRegister(redis), Turns(redis), lambda: now[0]
    )
    for passed in (0.0, LOST_ENTRY_SECONDS):
        now[0] = passed
        reaper.look()
        assert queue.waiting() == set()
    now[0] = LOST_ENTRY_SECONDS + 1
    reaper.look()
    assert queue.waiting() == {entry_id(job_id, 1)}
    now[0] *= 2
    reaper.look()
    assert len(queue.waiting()) == 1
