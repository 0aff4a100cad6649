"""Jobs through a real queue, a real worker and real job processes."""

from __future__ import annotations

import json
import os
import re
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient

from service.app import create_app
from service.settings import Settings
from tests.processes import alive, children_of
from tests.services import PATIENCE, form, running_worker, wait_for


@pytest.fixture
def client(settings: Settings) -> Iterator[TestClient]:
    with TestClient(create_app(settings), base_url="http://localhost") as made:
        yield made


def submit(client: TestClient, name: str) -> str:
    answer = client.post("/jobs", **form(name=name))
    assert answer.status_code == 202, answer.text
    return str(answer.json()["id"])


def state_of(client: TestClient, job_id: str) -> dict[str, Any]:
    return dict(client.get(f"/jobs/{job_id}").json())


def until(client: TestClient, job_id: str, *states: str, seconds: float = 30) -> dict[str, Any]:
    def look() -> dict[str, Any] | None:
        job = state_of(client, job_id)
        return job if job["state"] in states else None

    return wait_for(look, seconds, f"job {job_id} in {states}")


def test_a_job_succeeds_and_its_files_can_be_fetched(
    client: TestClient, settings: Settings
) -> None:
    job_id = submit(client, "ok.xyz")
    assert client.get(f"/jobs/{job_id}/mesh.glb").json()["code"] == "job.not_ready"
    with running_worker(settings):
        job = until(client, job_id, "succeeded", "failed")
    assert job["state"] == "succeeded"
    assert job["artifacts"]["slices/x/0.png"]["href"] == f"/jobs/{job_id}/slices/x/0.png"
    assert client.get(f"/jobs/{job_id}/mesh.glb").content.startswith(b"glTF")
    assert client.get(f"/jobs/{job_id}/mesh.ply").content.startswith(b"ply")
    assert client.get(f"/jobs/{job_id}/report.json").json() == {"attempt": 1}
    assert client.get(f"/jobs/{job_id}/slices/z/0.png").headers["content-type"] == "image/png"
    assert client.get(f"/jobs/{job_id}/slices/z/7.png").json()["code"] == "artifact.not_found"


def test_ends_of_every_kind(client: TestClient, settings: Settings) -> None:
    with running_worker(settings):
        line, twice, always = (
            submit(client, name) for name in ("line.xyz", "die-1.xyz", "die-99.xyz")
        )
        assert until(client, line, "failed")["problem"]["code"] == "cloud.collinear"
        assert until(client, twice, "succeeded")["attempt"] == 2
        ended = until(client, always, "failed")
        assert ended["problem"]["code"] == "job.crashed"
        assert ended["attempt"] == settings.max_attempts
    figures = client.get("/metrics").text
    for code in ("job.crashed", "cloud.collinear"):
        assert f'mpf_jobs_ended_total{{state="failed",code="{code}"}} 1' in figures


def test_cancel_running_and_queued(client: TestClient, settings: Settings) -> None:
    with running_worker(settings):
        running, queued = submit(client, "long-60.xyz"), submit(client, "ok.xyz")
        wait_for(lambda: state_of(client, running)["progress"], 20, "progress")
        assert state_of(client, queued)["queue_position"] == 0
        speed = re.search(r"^mpf_iterations_per_second (\S+)", client.get("/metrics").text, re.M)
        assert speed
        assert 10 < float(speed[1]) < 101  # it tells a hundred a second
        assert client.post(f"/jobs/{queued}/cancel").json()["state"] == "cancelled"
        assert client.post(f"/jobs/{running}/cancel").status_code == 202
        job = until(client, running, "cancelled", seconds=2 / PATIENCE)
        assert job["problem"]["code"] == "cancelled"
        stubborn = submit(client, "stubborn.xyz")
        wait_for(lambda: state_of(client, stubborn)["progress"], 20, "progress")
        assert client.post(f"/jobs/{stubborn}/cancel").json()["cancelling"] is True
        until(client, stubborn, "cancelled", seconds=5)


def test_a_surface_that_is_to_be_kept_has_its_time_too(
    client: TestClient, settings: Settings
) -> None:
    with running_worker(settings.model_copy(update={"keep_grace_seconds": 0.5})):
        stubborn = submit(client, "stubborn.xyz")
        wait_for(lambda: state_of(client, stubborn)["progress"], 20, "progress")
        assert client.post(f"/jobs/{stubborn}/cancel?keep=result").json()["cancelling"] is True
        assert until(client, stubborn, "cancelled", seconds=10)["artifacts"] == {}


def test_a_job_process_yields_to_the_whole_machine(client: TestClient, settings: Settings) -> None:
    with running_worker(settings.model_copy(update={"job_nice": 7})) as worker:
        job_id = submit(client, "long-30.xyz")
        wait_for(lambda: state_of(client, job_id)["progress"], 20, "progress")
        (pid,) = children_of(worker.pid)
        before = os.getpriority(os.PRIO_PROCESS, worker.pid)
        assert os.getpriority(os.PRIO_PROCESS, pid) == min(19, before + 7)
        assert os.getsid(pid) == pid
        groups = Path(f"/proc/{pid}/autogroup")
        if groups.exists() and groups.read_text():
            assert groups.read_text().split()[-2:] == ["nice", "7"]
            assert Path(f"/proc/{worker.pid}/autogroup").read_text() != groups.read_text()
        client.post(f"/jobs/{job_id}/cancel")
        until(client, job_id, "cancelled")


def test_memory_limit_fails_the_job_and_spares_the_worker(
    client: TestClient, settings: Settings
) -> None:
    limited = settings.model_copy(update={"job_memory_bytes": 2**30})
    with running_worker(limited):
        hungry = submit(client, "hungry.xyz")
        job = until(client, hungry, "failed")
        assert job["problem"]["code"] == "job.out_of_memory"
        until(client, submit(client, "ok.xyz"), "succeeded")


def test_sigterm_hands_the_job_back_and_another_worker_continues(
    client: TestClient, settings: Settings
) -> None:
    with running_worker(settings) as first:
        job_id = submit(client, "long-3.xyz")
        until(client, job_id, "running")
        wait_for(lambda: state_of(client, job_id)["progress"], 20, "progress")
        first.terminate()
        assert first.wait(15) == 0
    assert state_of(client, job_id)["state"] == "queued"
    with running_worker(settings):
        assert until(client, job_id, "succeeded")["attempt"] == 2


def test_a_killed_worker_takes_its_job_process_along_and_the_job_runs_again(
    client: TestClient, settings: Settings
) -> None:
    with running_worker(settings) as first:
        job_id = submit(client, "long-3.xyz")
        wait_for(lambda: state_of(client, job_id)["progress"], 20, "progress")
        children = children_of(first.pid)
        assert children
        os.kill(first.pid, signal.SIGKILL)
        first.wait()
        wait_for(lambda: not any(alive(pid) for pid in children), 5, "orphans gone")
    with running_worker(settings):
        job = until(client, job_id, "succeeded", seconds=40)
    assert job["attempt"] == 2
    assert json.loads(client.get(f"/jobs/{job_id}/report.json").text) == {"attempt": 2}
