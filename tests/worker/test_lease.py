"""What a worker's parent does about a job process: when it is killed, and what is cleared away."""

from __future__ import annotations

from threading import Event

import pytest
from redis import Redis

from service.artifacts.store import ArtifactStore
from service.jobs.lease import Lease
from service.jobs.model import FIT, TILE, Artifact, Job, JobState, new_job_id
from service.jobs.queue import JobQueue
from service.jobs.store import Creation
from service.jobs.tile_store import TileStore
from service.settings import FIT_SMALL, Settings
from worker.lease import LeaseKeeper
from worker.settle import settle

PROBLEM = {"code": "cancelled", "title": "t", "detail": "d", "status": 409}
BEAT = 0.05


@pytest.fixture
def store(redis: Redis) -> TileStore:
    return TileStore(redis, retention_seconds=100.0)


def queued(store: TileStore, redis: Redis, kind: str = FIT) -> Job:
    job = Job(id=new_job_id(), state=JobState.QUEUED, attempt=1, kind=kind, queue=FIT_SMALL)
    with redis.pipeline() as pipeline:
        store.create(job, Creation(), pipeline)
        pipeline.execute()
    return job


def running(store: TileStore, redis: Redis, part: str) -> Lease:
    """A whole fit, a tile, or the join of a job that was split."""
    job = queued(store, redis, TILE if part == "tile" else FIT)
    lease = Lease(job.id, 1, "a")
    store.start(lease)
    if part != "join":
        return lease
    tile = Job(id=new_job_id(), state=JobState.QUEUED, attempt=1, kind=TILE, parent=job.id)
    store.split(lease, [tile])
    found = store.get(job.id)
    assert found is not None and found.tiles is not None
    store.join(found, found.tiles)
    joining = Lease(job.id, 2, "a")
    store.start(joining, anew=False)
    return joining


@pytest.mark.parametrize(("part", "ends"), [("fit", True), ("tile", False), ("join", False)])
def test_only_a_whole_fit_that_is_to_be_kept_has_its_time(
    store: TileStore, redis: Redis, part: str, ends: bool
) -> None:
    lease, killed = running(store, redis, part), Event()
    store.ask_cancel(lease.job_id, "keep", PROBLEM)
    keeper = LeaseKeeper(
        store, lease, kill=killed.set, every=BEAT, cancel_grace=BEAT, keep_grace=BEAT, limit=60.0
    )
    with keeper:
        assert killed.wait(20 if ends else 20 * BEAT) is ends
        store.ask_cancel(lease.job_id, "discard", PROBLEM)
        assert killed.wait(20)


def test_a_kept_tile_that_takes_too_long_is_not_tried_for_ever(
    store: TileStore, redis: Redis, settings: Settings
) -> None:
    lease = running(store, redis, "tile")
    store.keep(lease.job_id)
    queue = JobQueue(redis, job_seconds=10)
    settle(lease, -9, store, queue, ArtifactStore(settings.data_dir), settings, overtime=True)
    found = store.get(lease.job_id)
    assert found is not None and (found.problem or {})["code"] == "job.time_limit"


def test_nothing_is_left_of_a_process_killed_after_its_job_had_ended(
    store: TileStore, redis: Redis, settings: Settings
) -> None:
    lease = running(store, redis, "fit")
    artifacts = ArtifactStore(settings.data_dir)
    artifacts.prepare()
    (settings.data_dir / "jobs" / lease.job_id).mkdir()
    scratch = artifacts.work(lease.job_id, lease.attempt)
    store.succeed(lease, {"mesh.ply": Artifact(3, "0" * 64)})
    settle(lease, -9, store, JobQueue(redis, job_seconds=10), artifacts, settings)
    assert not scratch.exists()
