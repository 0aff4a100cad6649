"""A cloud in tiles, from its split to the one result; all real but the numerics."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import pytest
from redis import Redis
from starlette.testclient import TestClient

from service.app import create_app
from service.jobs.model import JobState
from service.jobs.tile_store import TileStore
from service.settings import Settings
from tests.processes import alive, children_of
from tests.services import PATIENCE, form, running_worker, tell, wait_for

CANCEL_SECONDS = 2.0
"""At most, until all that a job runs has stopped."""


@pytest.fixture
def client(settings: Settings) -> Iterator[TestClient]:
    quick = settings.model_copy(update={"content_check_bytes": 0})
    with TestClient(create_app(quick), base_url="http://localhost") as made:
        yield made


@pytest.fixture
def store(redis: Redis) -> TileStore:
    return TileStore(redis, retention_seconds=100.0)


def submit(client: TestClient, name: str) -> str:
    answer = client.post("/jobs", **form(name=name))
    assert answer.status_code == 202, answer.text
    return str(answer.json()["id"])


def until(client: TestClient, job_id: str, *states: str) -> dict[str, Any]:
    def look() -> dict[str, Any] | None:
        job: dict[str, Any] = client.get(f"/jobs/{job_id}").json()
        return job if job["state"] in states else None

    return wait_for(look, 60, " or ".join(states))


def with_tiles(client: TestClient, job_id: str, running: int, done: int = 0) -> dict[str, Any]:
    def look() -> dict[str, Any] | None:
        job: dict[str, Any] = client.get(f"/jobs/{job_id}").json()
        assert job["state"] in ("queued", "running"), job["problem"]
        tiles = job["tiles"]
        return job if tiles and tiles["running"] >= running and tiles["done"] >= done else None

    return wait_for(look, 60, f"{running} tiles run")


def test_one_worker_does_all_of_what_is_one_job_to_its_owner(
    client: TestClient, settings: Settings, store: TileStore
) -> None:
    job_id = submit(client, "tiled-3-ok.xyz")
    with running_worker(settings):
        job = until(client, job_id, "succeeded", "failed")
    assert job["state"] == "succeeded", job["problem"]
    assert job["tiles"] == {"done": 3, "running": 0, "total": 3}
    assert job["attempt"] == 2
    report = client.get(f"/jobs/{job_id}/report.json").json()
    assert report == {"attempt": 2, "fields": ["tile 0", "tile 1", "tile 2"], "input": "input.xyz"}
    assert [one["id"] for one in client.get("/jobs").json()["jobs"]] == [job_id]
    # The stream tells of one job whose share only grows.
    told = client.get(f"/jobs/{job_id}/events", headers={"Last-Event-ID": "0-1"}).text
    assert '"tiles":{' in told
    assert told.count('"succeeded"') == 1
    # Nothing is left of the tiles but the result.
    wait_for(lambda: not store.families(), 10, "the tiles are gone")
    assert [p.name for p in (settings.data_dir / "jobs").iterdir()] == [job_id]
    left = {p.name for p in (settings.data_dir / "jobs" / job_id).iterdir()}
    assert left - {"at-work"} == {"input.xyz", "result-2"}
    ended = "".join(
        line for line in client.get("/metrics").text.splitlines() if "ended_total{" in line
    )
    assert ended == 'mpf_jobs_ended_total{state="succeeded",code=""} 1'
    # Its field serves as any.
    again = client.post(f"/jobs/{job_id}/extractions", json={"options": {}})
    assert again.json()["kind"] == "extraction"


def test_two_workers_fit_tiles_at_the_same_time_and_these_tell_of_their_job(
    client: TestClient, settings: Settings, store: TileStore
) -> None:
    capped = settings.model_copy(update={"running_per_owner": 1})
    job_id = submit(client, "tiled-2-tile3.xyz")
    fractions = []
    with running_worker(capped), running_worker(capped):
        job = with_tiles(client, job_id, running=2)
        other = submit(client, "ok.xyz")
        assert (job["state"], job["progress"]["stage"]) == ("running", "fit")
        tile_id = store.family(job_id).tiles[0].id
        for url in (f"/jobs/{tile_id}", f"/jobs/{tile_id}/report.json"):
            assert client.get(url).json()["code"] == "job.not_found"
        assert client.post(f"/jobs/{tile_id}/cancel").status_code == 404
        while (job := client.get(f"/jobs/{job_id}").json())["state"] in ("queued", "running"):
            fractions.append((job["progress"] or {}).get("fraction", 0.0))
            # The owner may run one job: that is this one, with all its tiles.
            assert client.get(f"/jobs/{other}").json()["state"] == "queued"
            time.sleep(0.05)
        assert until(client, other, "succeeded")
    assert fractions == sorted(fractions)
    assert len(set(fractions)) > 5
    assert job["state"] == "succeeded", job["problem"]


@pytest.mark.parametrize(
    ("part", "how"),
    [("split30", "cancel"), ("tile30", "cancel"), ("join30", "cancel"), ("tile30", "delete")],
)
def test_whatever_a_job_is_at_it_ends_when_its_owner_says_so(
    client: TestClient, settings: Settings, store: TileStore, part: str, how: str
) -> None:
    job_id = submit(client, f"tiled-2-{part}.xyz")
    with running_worker(settings) as worker:
        if part == "split30":
            wait_for(lambda: client.get(f"/jobs/{job_id}").json()["progress"], 30, "it splits")
        elif part == "tile30":
            with_tiles(client, job_id, running=1)
        else:
            wait_for(lambda: store.count(JobState.SUCCEEDED) == 2, 30, "its tiles are fitted")
            until(client, job_id, "running")
        at_work = children_of(worker.pid)
        begin = time.monotonic()
        if how == "cancel":
            client.post(f"/jobs/{job_id}/cancel")
        else:
            client.delete(f"/jobs/{job_id}")
        wait_for(lambda: not any(map(alive, at_work)), CANCEL_SECONDS / PATIENCE, "it stopped")
        tell(f"{part}, {how}: stopped after {time.monotonic() - begin:.1f} s")
        wait_for(lambda: not store.families(), 10, "its tiles are gone")
        # And the worker goes on with others.
        until(client, submit(client, "ok.xyz"), "succeeded")
    found = client.get(f"/jobs/{job_id}").json()
    if how == "cancel":
        assert found["state"] == "cancelled"
    else:
        assert found["code"] == "job.not_found"
    jobs = settings.data_dir / "jobs"
    assert len(list(jobs.iterdir())) == (2 if how == "cancel" else 1)
    assert not list(jobs.glob(f"{job_id}/result-*"))


def test_a_surface_so_far_is_that_of_all_tiles(
    client: TestClient, settings: Settings, store: TileStore
) -> None:
    job_id = submit(client, "tiled-2-tile60.xyz")
    with running_worker(settings):
        with_tiles(client, job_id, running=1)
        assert client.post(f"/jobs/{job_id}/cancel?keep=result").json()["cancelling"] is True
        job = until(client, job_id, "succeeded", "failed", "cancelled")
    assert job["state"] == "succeeded", job["problem"]
    fields = client.get(f"/jobs/{job_id}/report.json").json()["fields"]
    assert fields == [f"tile {n}, kept" for n in range(2)]


def test_a_split_that_is_to_be_kept_takes_its_time(client: TestClient, settings: Settings) -> None:
    short = settings.model_copy(update={"keep_grace_seconds": 0.5})
    job_id = submit(client, "tiled-2-split6.xyz")
    with running_worker(short):
        wait_for(lambda: client.get(f"/jobs/{job_id}").json()["progress"], 30, "it splits")
        client.post(f"/jobs/{job_id}/cancel?keep=result")
        job = until(client, job_id, "succeeded", "failed", "cancelled")
    assert (job["state"], job["attempt"]) == ("succeeded", 2), job["problem"]
    fields = client.get(f"/jobs/{job_id}/report.json").json()["fields"]
    assert fields == [f"tile {n}, kept" for n in range(2)]


@pytest.mark.parametrize(("task", "code"), [("line", "cloud.collinear"), ("die", "job.crashed")])
def test_a_tile_that_comes_to_nothing_ends_the_job(
    client: TestClient, settings: Settings, store: TileStore, task: str, code: str
) -> None:
    few = settings.model_copy(update={"max_attempts": 2})
    job_id = submit(client, f"tiled-2-{task}.xyz")
    with running_worker(few):
        job = until(client, job_id, "succeeded", "failed")
        assert job["state"] == "failed"
        assert (job["problem"]["code"], job["problem"]["where"]) == (code, "tile 2 of 2")
        wait_for(lambda: not store.families(), 10, "its tiles are gone")
    assert [p.name for p in (settings.data_dir / "jobs").iterdir()] == [job_id]
