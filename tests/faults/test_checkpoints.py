"""A fit that is killed, handed back or finds its checkpoint spoiled goes on as far as it can."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from safetensors import safe_open
from starlette.testclient import TestClient

from mpf_core.fit.trainer import FEWEST, KEEP_EVERY
from service.app import create_app
from service.settings import Settings
from tests.processes import children_of
from tests.services import form, running_worker, sphere_xyz, tell, wait_for

pytestmark = pytest.mark.slow

WORKER = "tests.worker.shipped"
ENDLESS: dict[str, Any] = {
    "preset": "draft", "resolution": 32, "slices": 1, "width": 32, "max_iterations": 200_000,
    "time_budget": 100_000.0,
}  # fmt: skip
LOST_SECONDS = 30.0  # at most, of fitting


@pytest.fixture
def client(settings: Settings) -> Iterator[TestClient]:
    quick = settings.model_copy(update={"content_check_bytes": 0})
    with TestClient(create_app(quick), base_url="http://localhost") as made:
        yield made


class Watched:
    """One endless fit, looked at from outside."""

    def __init__(self, client: TestClient, settings: Settings):
        self.client = client
        answer = client.post("/jobs", **form(sphere_xyz(600), **ENDLESS))
        assert answer.status_code == 202, answer.text
        self.url = f"/jobs/{answer.json()['id']}"
        self.folder = settings.data_dir / "jobs" / answer.json()["id"]

    def progress(self, attempt: int) -> dict[str, Any] | None:
        """The latest report of the fit of this attempt."""
        job = self.client.get(self.url).json()
        assert job["state"] in ("queued", "running"), job["problem"]
        found = job["progress"]
        fits = job["state"] == "running" and found and found["iteration"]
        return found if fits and job["attempt"] == attempt else None

    def wait(self, attempt: int) -> dict[str, Any]:
        return wait_for(lambda: self.progress(attempt), 60, f"attempt {attempt} fits")

    def checkpoint(self, attempt: int) -> Path:
        return self.folder / f"checkpoint-{attempt}"


def test_what_was_fitted_is_not_lost(client: TestClient, settings: Settings) -> None:
    fit = Watched(client, settings)
    with running_worker(settings, WORKER) as worker:
        fit.wait(1)
        wait_for(fit.checkpoint(1).exists, KEEP_EVERY + 30, "a checkpoint")
        killed_at = fit.wait(1)
        (pid,) = children_of(worker.pid)
        os.kill(pid, signal.SIGKILL)
        kept = iteration_in(fit.checkpoint(1))
        second = fit.wait(2)
        pace = killed_at["iteration"] / killed_at["seconds"]
        lost = (killed_at["iteration"] - kept) / pace
        tell(f"SIGKILL: {lost:.1f} s of fitting lost")
        assert lost < LOST_SECONDS
        assert second["iteration"] > max(20, kept)  # 20: of a fit that begins anew

        # SIGTERM keeps the state at once, however long ago the last checkpoint was written.
        before = fit.wait(2)["iteration"]
        worker.terminate()
        assert worker.wait(60) == 0
    assert client.get(fit.url).json()["state"] == "queued"
    with running_worker(settings, WORKER) as worker:
        third = fit.wait(3)["iteration"]
        tell(f"SIGTERM: at iteration {before} when told, went on before {third}")
        assert third >= before
        worker.terminate()
        assert worker.wait(60) == 0

    fit.checkpoint(3).write_bytes(fit.checkpoint(3).read_bytes()[:-100])
    with running_worker(settings, WORKER):
        assert fit.wait(4)["iteration"] < before
        wait_for(
            lambda: (fit.progress(4) or {}).get("iteration", 0) > FEWEST, 60, "enough for a surface"
        )
        client.post(f"{fit.url}/cancel?keep=result")
        ended = wait_for(lambda: _ended(client, fit.url), 60, "the end")
        assert ended["state"] == "succeeded", ended["problem"]
        report = client.get(ended["artifacts"]["report.json"]["href"]).json()
    assert report["fit"]["resumed_from"] is None
    assert "checkpoint" in report["fit"]["notes"][0]
    assert not list(fit.folder.glob("checkpoint-*"))


def iteration_in(checkpoint: Path) -> int:
    """At which iteration this state was kept."""
    with safe_open(checkpoint, framework="numpy") as file:
        return int(json.loads(file.metadata()["state"])["facts"]["iteration"])


def _ended(client: TestClient, url: str) -> dict[str, Any] | None:
    job: dict[str, Any] = client.get(url).json()
    return None if job["state"] in ("queued", "running") else job
