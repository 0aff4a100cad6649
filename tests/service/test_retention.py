"""What expires, when, and what a wrong clock may not do."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest
from redis import Redis
from starlette.testclient import TestClient

from service.app import create_app
from service.operations.retention import CALM_SECONDS, ClockWatch, Retention
from service.settings import Settings
from tests.services import form, wait_for


def test_an_ended_job_expires_with_its_files_and_is_gone_later(settings: Settings) -> None:
    brief = settings.model_copy(update={"retention_seconds": 1.5, "content_check_bytes": 0})
    with TestClient(create_app(brief), base_url="http://localhost") as client:
        state = client.app.state.mpf  # type: ignore[attr-defined]
        retention = Retention(state.store, state.artifacts, brief)
        waiting = client.post("/jobs", **form()).json()["id"]
        ended = client.post("/jobs", **form()).json()["id"]
        client.post(f"/jobs/{ended}/cancel")
        retention.round()
        assert client.get(f"/jobs/{ended}").status_code == 200

        def gone() -> bool:
            retention.round()
            return client.get(f"/jobs/{ended}").status_code == 410

        wait_for(gone, 5, "expiry")
        assert client.get(f"/jobs/{ended}").json()["code"] == "job.expired"
        assert client.get(f"/jobs/{ended}/mesh.glb").status_code == 410
        assert client.get(f"/jobs/{waiting}").json()["state"] == "queued"
        assert [p.name for p in (brief.data_dir / "jobs").iterdir()] == [waiting]
        (gone_job,) = client.get("/jobs", params={"state": "expired"}).json()["jobs"]
        assert gone_job["id"] == ended
        assert gone_job["created_at"] <= gone_job["finished_at"] <= gone_job["expires_at"]
        forgetful = brief.model_copy(update={"tombstone_seconds": 0.0})
        Retention(state.store, state.artifacts, forgetful).round()
        assert client.get(f"/jobs/{ended}").status_code == 404


def test_a_nearly_full_disk_refuses_uploads_and_expires_ended_jobs(
    settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick = settings.model_copy(update={"content_check_bytes": 0})
    with TestClient(create_app(quick), base_url="http://localhost") as client:
        state = client.app.state.mpf  # type: ignore[attr-defined]
        ended, waiting = (client.post("/jobs", **form()).json()["id"] for _ in range(2))
        client.post(f"/jobs/{ended}/cancel")
        monkeypatch.setattr(type(state.artifacts), "free_fraction", lambda _: 0.01)
        assert client.post("/jobs", **form()).json()["code"] == "storage.full"
        Retention(state.store, state.artifacts, quick).round()
        assert client.get(f"/jobs/{ended}").status_code == 410
        assert client.get(f"/jobs/{waiting}").status_code == 200


def test_files_of_nobody_are_removed_by_age(settings: Settings, redis: Redis) -> None:
    with TestClient(create_app(settings), base_url="http://localhost") as client:
        state = client.app.state.mpf  # type: ignore[attr-defined]
        old = time.time() - 2 * settings.orphan_seconds
        left: list[Path] = [
            settings.data_dir / "uploads" / "a",
            settings.data_dir / "jobs" / ("0" * 32),
        ]
        left[0].write_bytes(b"x")
        left[1].mkdir()
        fresh = settings.data_dir / "uploads" / "b"
        fresh.write_bytes(b"x")
        for path in left:
            os.utime(path, (old, old))
        Retention(state.store, state.artifacts, settings).round()
        assert not any(path.exists() for path in left)
        assert fresh.exists()


def test_nothing_expires_after_a_jump_of_the_clock() -> None:
    wall, steady = [1000.0], [0.0]
    watch = ClockWatch(lambda: wall[0], lambda: steady[0])
    for moved in (0.0, 10.0):
        wall[0] += moved
        steady[0] += moved
        assert watch.calm()
    wall[0] += 86_400
    assert not watch.calm()
    steady[0] += CALM_SECONDS / 2
    wall[0] += CALM_SECONDS / 2
    assert not watch.calm()
    steady[0] += CALM_SECONDS
    wall[0] += CALM_SECONDS
    assert watch.calm()
