"""A fit that is killed, handed back or finds its checkpoint spoiled goes on as far as it can."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import time
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
from tests.services import PATIENCE, form, running_worker, sphere_xyz, tell, wait_for

pytestmark = pytest.mark.slow

WORKER = "tests.worker.shipped"
ENDLESS: dict[str, Any] = {
    "preset": "draft", "resolution": 32, "slices": 1, "width": 32, "max_iterations": 200_000,
    "time_budget": 100_000.0,
}  # fmt: skip
SEED = 5
LOST_SECONDS = 30.0  # at most, of fitting
CANCEL_SECONDS = 2.0  # at most, until a fit has stopped
AGAIN_SECONDS = 60.0  # at most, until a job that lost its worker runs again


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

    def runs(self, attempt: int) -> bool:
        """Whether this attempt has begun."""
        job = self.client.get(self.url).json()
        return (job["state"], job["attempt"]) == ("running", attempt)

    def kept_at(self, attempt: int) -> float:
        """When this attempt last kept its state, s since 1970; 0 while it has not."""
        try:
            return self.checkpoint(attempt).stat().st_mtime
        except FileNotFoundError:
            return 0.0

    def checkpoint(self, attempt: int) -> Path:
        return self.folder / f"checkpoint-{attempt}"


def test_a_fit_that_is_killed_loses_little_and_goes_on_soon(
    client: TestClient, settings: Settings
) -> None:
    chance = random.Random(SEED)  # noqa: S311
    shipped = settings.model_copy(
        update={"lease_seconds": Settings.model_fields["lease_seconds"].default}
    )
    fit = Watched(client, shipped)
    with running_worker(shipped, WORKER) as first, running_worker(shipped, WORKER) as second:
        for attempt, kind in enumerate(("job process", "worker and job process"), start=1):
            fit.wait(attempt)
            begin = time.time()
            if attempt == 1:
                wait_for(lambda: fit.kept_at(1), KEEP_EVERY + 30, "a checkpoint")
            time.sleep(chance.uniform(0.0, KEEP_EVERY))
            worker, pid = _at_work(first, second)
            kept = iteration_in(fit.checkpoint(attempt))
            # What the attempt before had kept is older than this one.
            lost = time.time() - max(begin, fit.kept_at(attempt))
            os.kill(pid, signal.SIGKILL)
            if kind != "job process":
                worker.kill()
            killed = time.monotonic()
            wait_for(lambda a=attempt: fit.runs(a + 1), AGAIN_SECONDS, "the next attempt")
            again = time.monotonic() - killed
            gone_on = fit.wait(attempt + 1)["iteration"]
            tell(f"{kind} killed: {lost:.1f} s of fitting lost, running again after {again:.1f} s")
            assert lost < LOST_SECONDS
            assert again < AGAIN_SECONDS
            assert gone_on > max(20, kept)  # 20: of a fit that begins anew
        told = time.monotonic()
        client.post(f"{fit.url}/cancel")
        ended = wait_for(lambda: _ended(client, fit.url), CANCEL_SECONDS / PATIENCE, "the end")
        tell(f"cancelled: the fit had ended after {time.monotonic() - told:.1f} s")
        assert ended["state"] == "cancelled"


def _at_work(*workers: subprocess.Popen[bytes]) -> tuple[subprocess.Popen[bytes], int]:
    """The worker that has the job, and its job process."""
    for worker in workers:
        if worker.poll() is None and (jobs := children_of(worker.pid)):
            return worker, jobs[0]
    raise AssertionError("no worker has the job")


def test_what_was_fitted_goes_with_the_job_unless_it_is_damaged(
    client: TestClient, settings: Settings
) -> None:
    fit = Watched(client, settings)
    with running_worker(settings, WORKER) as worker:
        fit.wait(1)
        wait_for(lambda: fit.wait(1)["iteration"] > 60, 30, "some fitting")

        # SIGTERM keeps the state at once, however long ago the last checkpoint was written.
        before = fit.wait(1)["iteration"]
        worker.terminate()
        assert worker.wait(60) == 0
    assert client.get(fit.url).json()["state"] == "queued"
    with running_worker(settings, WORKER) as worker:
        second = fit.wait(2)["iteration"]
        tell(f"SIGTERM: at iteration {before} when told, went on before {second}")
        assert second >= before
        worker.terminate()
        assert worker.wait(60) == 0

    fit.checkpoint(2).write_bytes(fit.checkpoint(2).read_bytes()[:-100])
    with running_worker(settings, WORKER):
        assert fit.wait(3)["iteration"] < before
        wait_for(
            lambda: (fit.progress(3) or {}).get("iteration", 0) > FEWEST, 60, "enough for a surface"
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
