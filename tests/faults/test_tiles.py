"""A job in tiles survives the death of whatever works for it, in each of its parts."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx2
import pytest

from service.connection import connect
from service.jobs.tile_store import TileStore
from service.settings import Settings
from tests.processes import children_of
from tests.services import Server, form, running_api, running_worker, settings_for, tell, wait_for

pytestmark = pytest.mark.slow

TILES = 2
SECONDS = 3
"""Of work in each part."""


class Killed:
    """A job whose workers are killed, one after the other."""

    def __init__(self, api: str, job_id: str, settings: Settings):
        self.url = f"{api}/jobs/{job_id}"
        self._settings = settings

    def look(self) -> dict[str, Any]:
        job: dict[str, Any] = httpx2.get(self.url, timeout=20).json()
        assert job["state"] in ("queued", "running"), job
        return job

    @contextlib.contextmanager
    def until(self, ready: Callable[[dict[str, Any]], bool]) -> Iterator[None]:
        """A worker at work until it is so, which is killed, and its job process with it, after the
        block."""
        with running_worker(self._settings) as worker:
            wait_for(lambda: ready(self.look()) and children_of(worker.pid), 40, "that part")
            yield
            worker.kill()
            worker.wait()


def test_a_job_in_tiles_survives_a_kill_in_each_part(own_server: Server, tmp_path: Path) -> None:
    settings = settings_for(
        own_server, tmp_path, content_check_bytes=0, heartbeat_seconds=0.3, lease_seconds=1.5
    )
    redis = connect(settings)
    store = TileStore(redis, retention_seconds=100.0)
    name = f"tiled-{TILES}-each{SECONDS}.xyz"
    with running_api(settings) as api:
        job_id = httpx2.post(f"{api}/jobs", timeout=30, **form(name=name)).json()["id"]
        killed = Killed(api, job_id, settings)

        def splits(attempt: int) -> Callable[[dict[str, Any]], bool]:
            return lambda job: (
                (job["attempt"], job["tiles"]) == (attempt, None)
                and bool(job["progress"] and job["state"] == "running")
            )

        def fits(done: int) -> Callable[[dict[str, Any]], bool]:
            return lambda job: job["tiles"] and (job["tiles"]["done"], job["tiles"]["running"]) == (
                done, 1,
            )  # fmt: skip

        def joins(job: dict[str, Any]) -> bool:
            told = job["tiles"] or {}
            return bool(told.get("done") == TILES and job["state"] == "running")

        with killed.until(splits(1)):
            pass
        with killed.until(fits(0)):
            pass
        with killed.until(fits(1)):
            # The record of the waiting job is in the append-only file.
            own_server.kill()
            own_server.start()
        with killed.until(joins):
            pass
        with running_worker(settings):
            job = wait_for(lambda: _ended(killed.url), 60, "the end")
            wait_for(lambda: not store.families(), 10, "the tiles are gone")
        assert job["state"] == "succeeded", job["problem"]
        report = httpx2.get(f"{killed.url}/report.json", timeout=20).json()
        assert report["fields"] == [f"tile {n}" for n in range(TILES)]
        assert report["attempt"] == job["attempt"] == 4  # two to split, two to join

    events = redis.xrange(f"mpf:job:{job_id}:events")
    assert sum(b'"succeeded"' in told[b"data"] for _, told in events) == 1
    assert [p.name for p in (settings.data_dir / "jobs").iterdir()] == [job_id]
    folder = settings.data_dir / "jobs" / job_id
    assert [p.name for p in folder.glob("result-*")] == ["result-4"]
    assert not (folder / "two-at-once").exists()
    redis.close()
    tell("killed in split, in both tiles (once with Valkey), and in join: succeeded, once")


def _ended(url: str) -> dict[str, Any] | None:
    job: dict[str, Any] = httpx2.get(url, timeout=20).json()
    return None if job["state"] in ("queued", "running") else job
