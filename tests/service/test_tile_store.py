"""A job and its tiles: all of them come into being at once, and one look sees to what is due."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest
from redis import Redis

from service.artifacts.store import ArtifactStore
from service.jobs.family import Families
from service.jobs.index_store import live_key, owner_key, record_key, running_key
from service.jobs.lease import Lease, Refused
from service.jobs.model import TILE, Artifact, Input, Job, JobProgress, JobState, Tiles, new_job_id
from service.jobs.queue import JobQueue, entry_id
from service.jobs.store import Creation
from service.jobs.tile_store import FAMILIES_KEY, Family, Sight, TileStore, tiles_key
from service.jobs.tiles import (
    FIT_BEGINS,
    FIT_ENDS,
    JOIN_SHARE,
    SPLIT_SHARE,
    counted,
    progress_of,
    seconds_left,
)
from service.operations.estimates import Estimates
from service.operations.store import WorkerEntry, WorkerRegister
from service.settings import FIT_LARGE, FIT_SMALL, Settings
from worker.settle import settle

PROBLEM = {"code": "cloud.collinear", "title": "t", "detail": "d", "status": 422}
FILES = {"field.safetensors": Artifact(3, "0" * 64)}


@pytest.fixture
def store(redis: Redis) -> TileStore:
    return TileStore(redis, retention_seconds=100.0, progress_seconds=0.0)


@pytest.fixture
def queue(redis: Redis) -> JobQueue:
    return JobQueue(redis, job_seconds=10)


@pytest.fixture
def families(store: TileStore, queue: JobQueue, settings: Settings) -> Families:
    artifacts = ArtifactStore(settings.data_dir)
    artifacts.prepare()
    return Families(store, queue, artifacts)


def started(store: TileStore, redis: Redis) -> Lease:
    job = Job(id=new_job_id(), state=JobState.QUEUED, attempt=1, queue=FIT_SMALL, owner="anna")
    with redis.pipeline() as pipeline:
        store.create(job, Creation(), pipeline)
        pipeline.execute()
    lease = Lease(job.id, 1, "a")
    store.start(lease)
    return lease


def tiles_of(lease: Lease, count: int = 3) -> list[Job]:
    return [
        Job(id=new_job_id(), state=JobState.QUEUED, attempt=1, kind=TILE, parent=lease.job_id,
            queue=FIT_SMALL, owner="anna",
            input=Input(f"tile-{number}", "safetensors", 100 * (number + 1), "0" * 64))
        for number in range(count)
    ]  # fmt: skip


def split(store: TileStore, redis: Redis, count: int = 3) -> tuple[str, list[str]]:
    """A job that waits for its tiles."""
    lease = started(store, redis)
    tiles = tiles_of(lease, count)
    store.split(lease, tiles)
    return lease.job_id, [tile.id for tile in tiles]


def fit(store: TileStore, tile_id: str, attempt: int = 1) -> None:
    store.start(Lease(tile_id, attempt, "b"))
    store.succeed(Lease(tile_id, attempt, "b"), FILES)


def got(store: TileStore, job_id: str) -> Job:
    job = store.get(job_id)
    assert job is not None
    return job


def test_a_job_waits_for_its_tiles_without_a_lease(store: TileStore, redis: Redis) -> None:
    job_id, tiles = split(store, redis)
    job = got(store, job_id)
    assert (job.state, job.lease, job.split, job.in_tiles) == (JobState.RUNNING, "", 1, True)
    assert job.tiles == Tiles(3)
    assert set(store.in_state(JobState.QUEUED)) == set(tiles)
    assert store.waiting(FIT_SMALL) == 3
    # For its owner it is one job, and the tiles are none.
    assert redis.zrange(owner_key("anna"), 0, -1) == [job_id.encode()]
    assert redis.zrange(live_key("anna"), 0, -1) == [job_id.encode()]
    store.start(Lease(tiles[0], 1, "b"), most=1)
    assert redis.smembers(running_key("anna")) == {job_id.encode()}


@pytest.mark.parametrize(
    ("before", "reason"),
    [
        (lambda store, lease: store.reap(store.get(lease.job_id)), "illegal"),
        (lambda store, lease: store.ask_cancel(lease.job_id, "discard", PROBLEM), "cancelled"),
        (lambda store, lease: store.remove(store.get(lease.job_id)), "missing"),
    ],
)
def test_a_worker_that_lost_the_job_makes_no_tiles(
    store: TileStore, redis: Redis, before: Callable[[TileStore, Lease], object], reason: str
) -> None:
    lease = started(store, redis)
    before(store, lease)
    tiles = tiles_of(lease)
    with pytest.raises(Refused) as refusal:
        store.split(lease, tiles)
    assert refusal.value.reason == reason
    assert not any(store.get(tile.id) for tile in tiles)
    assert not redis.exists(tiles_key(lease.job_id), FAMILIES_KEY)


def test_the_last_tile_makes_the_job_wait_to_be_joined_once(
    store: TileStore, redis: Redis, families: Families, queue: JobQueue
) -> None:
    job_id, tiles = split(store, redis)
    for tile_id in tiles:
        families.look(job_id)
        assert got(store, job_id).in_tiles
        fit(store, tile_id)
    seen = got(store, job_id)
    # A crash between the last tile's end and this: whoever looks next does it, the others nothing.
    for _ in range(3):
        families.look_at_all()
    job = got(store, job_id)
    assert (job.state, job.attempt, job.split, job.tries) == (JobState.QUEUED, 2, 1, 1)
    assert job.tiles == Tiles(3, 3, 0)
    assert entry_id(job_id, 2) in queue.waiting()
    with pytest.raises(Refused):
        store.join(seen, Tiles(3, 3))
    # It has waited already, and keeps its place among the owner's running jobs.
    other = started(store, redis)
    store.hand_back(other)
    assert store.position(job) == 0
    assert store.start(Lease(job_id, 2, "c"), most=1).tries == 1


def test_a_join_that_dies_has_attempts_of_its_own_and_is_not_split_again(
    store: TileStore, redis: Redis, families: Families
) -> None:
    job_id, tiles = split(store, redis, 1)
    fit(store, tiles[0])
    families.look(job_id)
    store.start(Lease(job_id, 2, "c"), anew=False)
    store.hand_back(Lease(job_id, 2, "c"))
    families.look_at_all()
    job = got(store, job_id)
    assert (job.state, job.attempt, job.tries, job.in_tiles) == (JobState.QUEUED, 3, 2, False)
    assert store.family(job_id).tiles
    store.start(Lease(job_id, 3, "d"), anew=False)
    store.succeed(Lease(job_id, 3, "d"), FILES)
    families.look_at_all()
    assert not any(store.get(tile_id) for tile_id in tiles)
    assert store.families() == []


def test_a_tile_that_fails_fails_the_job_and_ends_the_others(
    store: TileStore, redis: Redis, families: Families, queue: JobQueue
) -> None:
    job_id, tiles = split(store, redis)
    for tile in tiles:
        queue.enqueue(got(store, tile), 1)
    store.start(Lease(tiles[0], 1, "b"))
    store.start(Lease(tiles[1], 1, "b"))
    store.fail(Lease(tiles[1], 1, "b"), PROBLEM)
    families.look(job_id)
    job = got(store, job_id)
    assert job.state is JobState.FAILED
    assert job.problem == PROBLEM | {"where": "tile 2 of 3"}
    assert not any(store.get(tile_id) for tile_id in tiles)
    assert store.heed(Lease(tiles[0], 1, "b")) == (False, "")
    assert entry_id(tiles[2], 1) not in queue.waiting()
    assert store.counts()["failed cloud.collinear"] == 1


def test_who_asks_by_http_leaves_files_to_those_who_look_later(
    store: TileStore, redis: Redis, families: Families, settings: Settings
) -> None:
    job_id, tiles = split(store, redis)
    folders = [settings.data_dir / "jobs" / tile_id for tile_id in tiles]
    for folder in folders:
        folder.mkdir()
    store.start(Lease(tiles[0], 1, "b"))
    store.ask_cancel(job_id, "discard", PROBLEM)
    families.look(job_id, files=False)
    assert not any(store.get(tile_id) for tile_id in tiles)
    assert store.heed(Lease(tiles[0], 1, "b")) == (False, "")
    assert all(folder.is_dir() for folder in folders)
    families.look_at_all()
    assert not any(folder.exists() for folder in folders)
    assert store.families() == []


def test_what_the_job_tells_never_falls(store: TileStore, redis: Redis) -> None:
    job_id, _ = split(store, redis)
    job = got(store, job_id)
    for told in (0.3, 0.2, 0.4):
        store.tell(job, JobProgress("fit", told, 1.0, eta=5.0), Tiles(3, 1, 1))
        events = redis.xrevrange(f"mpf:job:{job_id}:events", count=1)
        assert b'"tiles":' in events[0][1][b"data"]
    found = [b'"fraction":0.3', b'"fraction":0.3', b'"fraction":0.4']
    stream = [
        e[b"data"] for _, e in redis.xrange(f"mpf:job:{job_id}:events") if b"fit" in e[b"data"]
    ]
    assert all(want in have for want, have in zip(found, stream, strict=True))
    now = got(store, job_id)
    assert now.tiles == Tiles(3, 1, 1)
    assert now.progress == JobProgress("fit", 0.4, 1.0, eta=5.0)
    # What was seen earlier is told later: no tile is unfitted by that.
    store.tell(job, JobProgress("fit", 0.4, 1.0, eta=5.0), Tiles(3, 0, 2))
    assert got(store, job_id).tiles == Tiles(3, 1, 1)
    # Of a job that does not wait any more nothing is told.
    store.ask_cancel(job_id, "discard", PROBLEM)
    store.tell(job, JobProgress("fit", 0.5, 1.0), Tiles(3))
    assert got(store, job_id).progress == now.progress


def test_those_who_listen_hear_no_more_often_than_of_any_job(
    store: TileStore, redis: Redis
) -> None:
    job_id, _ = split(store, redis)
    job, rationed = got(store, job_id), TileStore(redis, retention_seconds=1, progress_seconds=60)
    for done in range(3):
        rationed.tell(job, JobProgress("fit", 0.2 + done / 10, 1.0), Tiles(3, done))
    stream = [e[b"data"] for _, e in redis.xrange(f"mpf:job:{job_id}:events")]
    assert sum(b"fit" in data for data in stream) == 1
    assert got(store, job_id).tiles == Tiles(3, 2)  # the record knows all


def test_a_job_that_is_to_be_kept_ends_its_tiles_and_joins_them(
    store: TileStore, redis: Redis, families: Families
) -> None:
    job_id, tiles = split(store, redis, 2)
    store.start(Lease(tiles[0], 1, "b"))
    assert store.ask_cancel(job_id, "keep", PROBLEM).state is JobState.RUNNING
    families.look(job_id)
    assert [store.family(job_id).tiles[n].cancel for n in (0, 1)] == ["keep", "keep"]
    store.succeed(Lease(tiles[0], 1, "b"), FILES)
    fit(store, tiles[1])
    families.look(job_id)
    job = got(store, job_id)
    # Nothing is left to be cut short: what remains may take its time.
    assert (job.state, job.cancel) == (JobState.QUEUED, "")
    assert store.ask_cancel(job_id, "keep", PROBLEM).state is JobState.QUEUED
    assert store.ask_cancel(job_id, "discard", PROBLEM).state is JobState.CANCELLED


def test_a_tile_that_is_kept_and_loses_its_process_is_tried_again(
    store: TileStore, redis: Redis, families: Families, queue: JobQueue, settings: Settings
) -> None:
    job_id, (tile_id,) = split(store, redis, 1)
    lease = Lease(tile_id, 1, "b")
    store.start(lease)
    store.ask_cancel(job_id, "keep", PROBLEM)
    families.look(job_id)
    settle(lease, -9, store, queue, ArtifactStore(settings.data_dir), settings)
    tile = got(store, tile_id)
    assert (tile.state, tile.attempt, tile.cancel) == (JobState.QUEUED, 2, "keep")
    assert got(store, job_id).in_tiles


def test_a_lost_record_of_a_tile_is_no_reason_to_wait_for_ever(
    store: TileStore, redis: Redis, families: Families
) -> None:
    job_id, tiles = split(store, redis)
    redis.delete(record_key(tiles[2]))
    families.look_at_all()
    assert (got(store, job_id).problem or {})["code"] == "job.crashed"


def test_a_job_that_waits_for_its_tiles_holds_no_worker(
    store: TileStore, redis: Redis, settings: Settings
) -> None:
    register = WorkerRegister(redis)
    register.sign("w", WorkerEntry((FIT_SMALL,), 1, 0, {FIT_SMALL: 10.0}))
    _, (tile_id,) = split(store, redis, 1)
    other = Job(id=new_job_id(), state=JobState.QUEUED, attempt=1, queue=FIT_SMALL)
    estimates = Estimates(store, register, settings)
    estimates.refresh()
    # Behind the tile, which waits: two fits.
    assert estimates.eta(other, 1) == pytest.approx(20.0)
    store.start(Lease(tile_id, 1, "b"))
    estimates = Estimates(store, register, settings)
    estimates.refresh()
    assert estimates.eta(other, 0) == pytest.approx(20.0, abs=0.5)
    # A cloud that is to be split takes as long as its tiles, their making and their joining.
    large = replace(
        other,
        options={"tiles": "auto", "tile_points": 500},
        input=Input("a.xyz", "xyz", 1, "0" * 64, points=501),
    )
    each = 10.0 * (1 + SPLIT_SHARE + JOIN_SHARE)
    assert estimates.eta(large, 0) == pytest.approx(10.0 + 2 * each, abs=0.5)
    assert estimates.eta(replace(large, queue=FIT_LARGE), 0) is None  # no worker takes that
    whole = replace(large, options={"tiles": "off", "tile_points": 500})
    assert estimates.eta(whole, 0) == pytest.approx(20.0, abs=0.5)
    paper = replace(large, options={"preset": "paper", "tile_points": 500})  # no warm start
    assert estimates.eta(paper, 0) == pytest.approx(20.0, abs=0.5)


def test_tiles_wait_in_a_queue_of_their_own_weight(
    store: TileStore, redis: Redis, settings: Settings
) -> None:
    register = WorkerRegister(redis)
    queues = (FIT_SMALL, FIT_LARGE)
    for name in "ab":
        register.sign(name, WorkerEntry(queues, 1, 0, {FIT_SMALL: 10.0}))
    job = Job(
        id=new_job_id(), state=JobState.QUEUED, attempt=1, queue=FIT_LARGE,
        options={"tile_points": 400_000}, input=Input("a.ply", "ply", 1, "0" * 64, 1_200_000),
    )  # fmt: skip
    estimates = Estimates(store, register, settings)
    estimates.refresh()
    # Three tiles on two workers, and nobody knows how long what goes before it takes.
    seconds = 2 * 10.0 + 3 * 10.0 * (SPLIT_SHARE + JOIN_SHARE)
    assert estimates.eta(job, 0) == pytest.approx(seconds)
    assert estimates.eta(job, 1) is None


def test_shares_and_times_come_from_the_tiles() -> None:
    tiles = (
        Sight("a", JobState.SUCCEEDED, weight=300, fraction=1.0, took=10.0),
        Sight("b", JobState.RUNNING, weight=100, fraction=0.5, eta=6.0, points_per_second=7.0),
        Sight("c", JobState.QUEUED, weight=100),
    )
    told = progress_of(Family(None, tiles, 12.0))
    assert told.fraction == pytest.approx(FIT_BEGINS + 0.7 * (FIT_ENDS - FIT_BEGINS))
    assert (told.stage, told.seconds, told.points_per_second) == ("fit", 12.0, 7.0)
    assert told.eta == pytest.approx(6.0 + 10.0 + 3 * 10.0 * JOIN_SHARE)
    assert counted(tiles) == Tiles(3, 1, 1)
    # Before the first has ended by what it says itself; with nothing known, nothing.
    assert seconds_left(tiles[1:]) == pytest.approx(6.0 + 12.0 + 2 * 12.0 * JOIN_SHARE)
    assert seconds_left(tiles[2:]) is None
