"""Queues by weight, who takes from which, and what is said of when a job will be done."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner
from redis import Redis
from starlette.testclient import TestClient

from mpf_core.options import PRESETS, options_to_mapping
from service.app import create_app
from service.artifacts.opened import artifacts_of
from service.jobs.lease import Lease
from service.jobs.model import EXTRACTION, FIT, Input
from service.jobs.queue import JobQueue, queue_for
from service.jobs.tile_store import TileStore
from service.operations.estimates import Outlook
from service.operations.store import Turns, WorkerEntry, WorkerRegister
from service.settings import QUEUES, Settings, usable_cores
from tests.services import form, running_worker, wait_for
from worker.cli import worker as worker_command
from worker.reaper import Reaper


def test_the_weight_of_a_job_names_its_queue(settings: Settings) -> None:
    cloud = Input("a.ply", "ply", 1, "", points=20_000)
    vast = Input("a.ply", "ply", 1, "", points=3_000_000)
    presets = {name: options_to_mapping(preset) for name, preset in PRESETS.items()}
    assert queue_for(FIT, presets["draft"], cloud, settings) == "fit-small"
    assert queue_for(FIT, presets["balanced"], cloud, settings) == "fit-small"
    assert queue_for(FIT, presets["paper"], cloud, settings) == "fit-large"
    assert queue_for(FIT, presets["draft"], vast, settings) == "fit-large"
    more = presets["draft"] | {"max_iterations": 200_000}
    assert queue_for(FIT, more, cloud, settings) == "fit-large"
    assert queue_for(EXTRACTION, {}, None, settings) == "extract"


def test_workers_take_from_their_queues_only(settings: Settings) -> None:
    quick = settings.model_copy(update={"content_check_bytes": 0})
    small_only = settings.model_copy(update={"queues": ("extract", "fit-small")})
    with TestClient(create_app(quick), base_url="http://localhost") as client:

        def state(job_id: str) -> str:
            return str(client.get(f"/jobs/{job_id}").json()["state"])

        large = client.post("/jobs", **form(name="ok.xyz", preset="paper")).json()
        assert (large["queue"], large["queue_position"], large["eta"]) == ("fit-large", 0, None)
        small = [client.post("/jobs", **form(name="ok.xyz")).json() for _ in range(3)]
        # Those before a job in another queue are not before it.
        assert [job["queue_position"] for job in small] == [0, 1, 2]
        told = client.get("/metrics").text
        assert 'mpf_queue_jobs{queue="fit-small"} 3' in told
        assert 'mpf_queue_jobs{queue="fit-large"} 1' in told
        with running_worker(small_only):
            wait_for(lambda: state(small[2]["id"]) == "succeeded", 20, "the small ones")
            assert 'mpf_queue_workers{queue="fit-large"} 0' in client.get("/metrics").text
            child = client.post(f"/jobs/{small[0]['id']}/extractions").json()
            assert child["queue"] == "extract"
            wait_for(lambda: state(child["id"]) == "succeeded", 20, "the extraction")
            again = client.post(f"/jobs/{small[0]['id']}/retry").json()
            wait_for(lambda: state(again["id"]) == "succeeded", 20, "the retry")
            assert state(large["id"]) == "queued"
            register = WorkerRegister(client.app.state.mpf.redis)  # type: ignore[attr-defined]
            (entry,) = wait_for(register.entries, 5, "an entry")
            assert entry.queues == ("extract", "fit-small")
            assert entry.threads == settings.threads_per_job()
            wait_for(
                lambda: "fit-small" in register.entries()[0].seconds, 10, "its pace is told"
            )  # fmt: skip
            assert 0 < register.entries()[0].seconds["fit-small"] < 60
        with running_worker(settings.model_copy(update={"queues": ("fit-large",)})):
            wait_for(lambda: state(large["id"]) == "succeeded", 20, "the large one")


def test_extractions_go_before_fits(settings: Settings) -> None:
    quick = settings.model_copy(update={"content_check_bytes": 0})
    with TestClient(create_app(quick), base_url="http://localhost") as client:
        with running_worker(settings):
            first = client.post("/jobs", **form(name="ok.xyz")).json()["id"]
            wait_for(lambda: client.get(f"/jobs/{first}").json()["state"] == "succeeded", 20, "it")
        fits = [client.post("/jobs", **form(name="ok.xyz")).json()["id"] for _ in range(3)]
        taken = client.post(f"/jobs/{first}/extractions").json()["id"]
        with running_worker(settings):
            ended = lambda job: client.get(f"/jobs/{job}").json()["state"] == "succeeded"  # noqa: E731
            wait_for(lambda: ended(fits[-1]), 30, "all of them")
        began = [client.get(f"/jobs/{job}").json()["started_at"] for job in (taken, *fits)]
        assert began == sorted(began)


def test_a_waiting_job_is_told_when_it_will_be_done(settings: Settings, redis: Redis) -> None:
    quick = settings.model_copy(update={"content_check_bytes": 0})
    register = WorkerRegister(redis)
    for name in ("one", "two"):
        register.sign(name, WorkerEntry(QUEUES, 1, 0, {"fit-small": 30.0}))
    with TestClient(create_app(quick), base_url="http://localhost") as client:
        jobs = [client.post("/jobs", **form(name="ok.xyz")).json()["id"] for _ in range(5)]
        etas = [client.get(f"/jobs/{job}").json()["eta"] for job in jobs]
    assert etas == [30.0, 30.0, 60.0, 75.0, 90.0]


def test_an_outlook_counts_what_goes_first() -> None:
    both = WorkerEntry(QUEUES, 1, 0, {"extract": 5.0, "fit-small": 40.0})
    large = WorkerEntry(("fit-large",), 4, 0, {"fit-large": 600.0})
    seen = Outlook([both, large], {"extract": 2, "fit-small": 3}, {"fit-small": [10.0]})
    assert seen.seconds_to_end("fit-small", 1) == pytest.approx(2 * 5 + 40 + 10 + 40)
    assert seen.seconds_to_end("extract", 0) == pytest.approx(10 + 5)
    assert Outlook([], {}, {}).seconds_to_end("extract", 0) is None
    assert Outlook([large], {}, {}).seconds_to_end("extract", 0) is None


def test_the_threads_of_all_workers_are_the_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    for cores in (1, 2, 7, 8, 64):
        monkeypatch.setattr("service.settings.usable_cores", lambda cores=cores: cores)
        for workers in range(1, 12):
            shares = [
                Settings(workers=workers, worker_index=index).threads_per_job()
                for index in range(workers)
            ]
            assert sum(shares) == max(cores, workers)
            assert max(shares) - min(shares) <= 1


def test_a_container_s_quota_counts_as_its_cores(tmp_path: Path) -> None:
    quota = tmp_path / "cpu.max"
    quota.write_text("100000 100000\n")
    assert usable_cores(quota) == 1
    quota.write_text("50000 100000\n")
    assert usable_cores(quota) == 1
    quota.write_text("max 100000\n")
    assert usable_cores(quota) == usable_cores(tmp_path / "missing")


def test_a_queue_that_is_none_is_refused() -> None:
    told = CliRunner().invoke(worker_command, ["--queues", "extract,huge"])
    assert told.exit_code == 2
    assert "huge" in told.output
    assert "fit-large" in told.output


def test_of_many_workers_one_looks_after_lost_jobs(settings: Settings, redis: Redis) -> None:
    quick = settings.model_copy(update={"content_check_bytes": 0, "lease_seconds": 4.0})
    register = WorkerRegister(redis)
    store = TileStore(redis, retention_seconds=60)
    queue = JobQueue(redis, job_seconds=60)
    passed = [0.0]
    reapers = [
        Reaper(store, queue, artifacts_of(quick), quick, register, Turns(redis), lambda: passed[0])
        for _ in range(2)
    ]
    with TestClient(create_app(quick), base_url="http://localhost") as client:
        job_id = client.post("/jobs", **form(name="ok.xyz")).json()["id"]
    store.start(Lease(job_id, 1, "lost"))
    for number in range(20):
        register.sign(f"worker {number}", WorkerEntry(QUEUES, 1, 0))
    for reaper in (reapers[0], reapers[1]):
        reaper.look()
    passed[0] += 5
    reapers[1].look()
    assert store.get(job_id).attempt == 1  # type: ignore[union-attr]
    reapers[0].look()
    assert store.get(job_id).attempt == 2  # type: ignore[union-attr]
    redis.delete("mpf:turn:reaper")  # the one that looked is lost
    reapers[1].look()
    assert Turns(redis).hold("reaper", 1.0) is False
