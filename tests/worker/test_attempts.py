"""Attempts at a job in tiles, run one by one in this process: a fault falls where it is wanted."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from threading import Timer

import pytest
from redis import Redis
from starlette.testclient import TestClient

from service.app import create_app
from service.artifacts.bucket import bucket_at
from service.artifacts.object_store import ObjectArtifacts
from service.connection import connect
from service.jobs.lease import Lease
from service.jobs.model import Job, JobState
from service.jobs.queue import JobQueue
from service.jobs.tile_store import TileStore
from service.settings import FIT_LARGE, FIT_SMALL, Settings
from tests.services import Server, form, settings_for
from tests.worker import plumbing
from worker import runners
from worker.tasks import Attempt
from worker.tiles import TileWork

AWAY_SECONDS = 1.5


@pytest.fixture(autouse=True)
def _plumbing(monkeypatch: pytest.MonkeyPatch) -> None:
    kinds = {"split": plumbing.split_runner, "tile": plumbing.tile_runner}
    for name, run in (kinds | {"join": plumbing.join_runner}).items():
        monkeypatch.setitem(runners.RUNNERS, name, run)
    monkeypatch.setattr(runners, "is_large", plumbing.is_large)


class Bench:
    """A service without a worker, and attempts at its jobs."""

    def __init__(self, settings: Settings):
        self.settings = settings
        self.redis: Redis = connect(settings)
        self.store = TileStore(self.redis, retention_seconds=100.0)

    def submit(self, name: str) -> str:
        quick = self.settings.model_copy(update={"content_check_bytes": 0})
        with TestClient(create_app(quick), base_url="http://localhost") as client:
            return str(client.post("/jobs", **form(name=name)).json()["id"])

    def job(self, job_id: str) -> Job:
        found = self.store.get(job_id)
        assert found is not None
        return found

    def attempt(self, job_id: str) -> Attempt:
        lease = Lease(job_id, self.job(job_id).attempt, "bench")
        return Attempt(lease, self.redis, self.settings)

    def fitted(self, name: str) -> str:
        """A job that waits to be joined."""
        job_id = self.submit(name)
        self.attempt(job_id).run()
        for tile in self.store.family(job_id).tiles:
            self.attempt(tile.id).run()
        assert self.job(job_id).state is JobState.QUEUED
        return job_id


@pytest.fixture
def bench(settings: Settings) -> Bench:
    return Bench(settings)


@pytest.fixture
def own_bench(own_server: Server, tmp_path: Path) -> Iterator[Bench]:
    made = Bench(settings_for(own_server, tmp_path))
    yield made
    made.redis.close()


def test_a_join_waits_for_redis(own_bench: Bench, own_server: Server) -> None:
    job_id = own_bench.fitted("tiled-2-ok.xyz")
    attempt = own_bench.attempt(job_id)
    job = attempt._start()
    own_server.kill()
    back = Timer(AWAY_SECONDS, own_server.start)
    back.start()
    attempt._finish(attempt._outcome(job))
    back.join()
    ended = own_bench.job(job_id)
    assert (ended.state, ended.problem) == (JobState.SUCCEEDED, None)


def test_the_samples_of_a_tile_name_its_queue(bench: Bench) -> None:
    for most, queue in ((plumbing.SAMPLES, FIT_SMALL), (plumbing.SAMPLES - 1, FIT_LARGE)):
        bench.settings = bench.settings.model_copy(update={"large_fit_points": most})
        job_id = bench.submit("tiled-2-ok.xyz")
        bench.attempt(job_id).run()
        tiles = [bench.job(tile.id) for tile in bench.store.family(job_id).tiles]
        assert [tile.queue for tile in tiles] == [queue, queue]
        assert [tile.input and tile.input.points for tile in tiles] == [plumbing.SAMPLES] * 2


def test_no_more_tiles_than_a_job_may_have(bench: Bench) -> None:
    """Of a cloud whose points were not counted when it came."""
    bench.settings = bench.settings.model_copy(update={"tiles_per_job": 2})
    job_id = bench.submit("tiled-3-ok.xyz")
    bench.attempt(job_id).run()
    problem = bench.job(job_id).problem or {}
    assert (problem["code"], problem["where"]) == ("options.invalid", "tile_points")
    assert not bench.store.family(job_id).tiles


def test_scratch_is_gone_before_others_are_seen_to(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The process may be killed from there on."""
    job_id = bench.submit("tiled-2-line.xyz")
    bench.attempt(job_id).run()
    tiles = [tile.id for tile in bench.store.family(job_id).tiles]
    seen: list[Path] = []

    def look(families: object, looked_at: str) -> None:
        assert looked_at == job_id
        seen.extend(bench.settings.data_dir.glob("jobs/*/work-*"))

    monkeypatch.setattr("worker.tiles.Families.look", look)
    bench.attempt(tiles[1]).run()
    assert bench.job(tiles[1]).state is JobState.FAILED
    assert seen == []


def test_a_split_that_came_to_nothing_leaves_no_files(bench: Bench) -> None:
    job_id = bench.submit("tiled-2-ok.xyz")
    attempt = bench.attempt(job_id)
    job = attempt._start()
    outcome = attempt._outcome(job)
    folders = bench.settings.data_dir / "jobs"
    assert len(list(folders.iterdir())) == 3
    bench.store.reap(bench.job(job_id))
    attempt._finish(outcome)
    attempt._tiles.ended(job)
    assert [path.name for path in folders.iterdir()] == [job_id]
    # One that is believed lost only because the answer was has made tiles, and they stay.
    attempt = bench.attempt(job_id)
    outcome = attempt._outcome(attempt._start())
    outcome()
    attempt._finish(outcome)
    attempt._tiles.ended(job)
    tiles = {tile.id for tile in bench.store.family(job_id).tiles}
    assert {path.name for path in folders.iterdir()} == {job_id, *tiles}


def test_tiles_that_a_store_took_half_of_are_not_copied_twice(bench: Bench, tmp_path: Path) -> None:
    bucket = bucket_at(bench.settings.model_copy(update={"store_url": "memory:///"}))
    artifacts = ObjectArtifacts(bucket, tmp_path / "scratch")
    artifacts.prepare()
    job = bench.job(bench.submit("tiled-2-ok.xyz"))
    out = artifacts.work(job.id, 1)
    samples = {f"tile-{n}.safetensors": plumbing.SAMPLES for n in range(2)}
    for name in samples:
        (out / name).write_bytes(b"tile")
    files = artifacts.publish(job.id, 1)
    queue, lease = JobQueue(bench.redis, job_seconds=10), Lease(job.id, 1, "bench")
    work = TileWork(bench.store, queue, artifacts, lease, bench.settings)
    first, second = (work.made(job, files, samples) for _ in range(2))
    assert first == second
    assert set(artifacts.job_ids()) == {job.id, *(tile.id for tile in first)}
    artifacts.discard_work(job.id, 1)


def test_a_join_that_cannot_wait_is_tried_as_often_as_any_other_part(
    own_bench: Bench, own_server: Server
) -> None:
    """Splitting has used up attempts that do not count against joining."""
    impatient = own_bench.settings.model_copy(
        update={"redis_patience_seconds": 0.0, "max_attempts": 2}
    )
    job_id = own_bench.fitted("tiled-2-ok.xyz")
    states = []
    for _ in range(2):
        attempt = Attempt(
            Lease(job_id, own_bench.job(job_id).attempt, "bench"), own_bench.redis, impatient
        )
        job = attempt._start()
        own_server.kill()
        outcome = attempt._outcome(job)
        own_server.start()
        attempt._finish(outcome)
        states.append(own_bench.job(job_id).state)
    assert states == [JobState.QUEUED, JobState.FAILED]
    assert (own_bench.job(job_id).problem or {})["code"] == "service.unavailable"
