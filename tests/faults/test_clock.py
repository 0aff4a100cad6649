"""The machine's clock jumps by days under Valkey, API, worker and job process."""

from __future__ import annotations

import shutil
import struct
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import httpx2
import pytest
from redis import Redis

from tests.services import (
    Server,
    form,
    running_api,
    running_worker,
    settings_for,
    wait_for,
)

HERE = Path(__file__).parent
DAY = 86_400
TUS = {"Tus-Resumable": "1.0.0"}


@pytest.fixture
def jump(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[int], None]]:
    """Moves the wall clock of every process that is started from here on, as it runs."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("there is no C compiler to build the movable clock with")
    library, offset = tmp_path / "clock.so", tmp_path / "clock"
    build = [compiler, "-O1", "-shared", "-fPIC", "-o", str(library), str(HERE / "clock.c")]
    subprocess.run(build, check=True)
    offset.write_bytes(struct.pack("q", 0))
    monkeypatch.setenv("LD_PRELOAD", str(library))
    monkeypatch.setenv("MPF_CLOCK_FILE", str(offset))
    with offset.open("r+b", buffering=0) as file:

        def move(seconds: int) -> None:
            file.seek(0)
            file.write(struct.pack("q", seconds))

        yield move


@pytest.fixture
def server(jump: Callable[[int], None]) -> Iterator[Server]:
    with tempfile.TemporaryDirectory(prefix="mpf-") as folder:
        made = Server(Path(folder))
        made.start()
        yield made
        made.stop()


def test_no_job_is_lost_reaped_or_expired_when_the_clock_jumps(
    jump: Callable[[int], None], server: Server, tmp_path: Path
) -> None:
    settings = settings_for(
        server, tmp_path, content_check_bytes=0, retention_round_seconds=0.3, lease_seconds=6.0
    )
    with (
        running_api(settings) as api,
        running_worker(settings),
        httpx2.Client(base_url=api, timeout=60) as client,
    ):

        def submit(name: str) -> str:
            return str(client.post("/jobs", **form(name=name)).json()["id"])

        def state(job_id: str) -> str:
            return str(client.get(f"/jobs/{job_id}").json().get("state"))

        def has_state(job_id: str, wanted: str) -> Callable[[], bool]:
            return lambda: state(job_id) == wanted

        ended = submit("ok.xyz")
        wait_for(has_state(ended, "succeeded"), 20, "the first")
        upload = client.post("/uploads", headers=TUS | {"Upload-Length": "100"})
        running, waiting = submit("long-12.xyz"), submit("ok.xyz")
        wait_for(has_state(running, "running"), 20, "the second runs")
        before = server_time(server)
        for days in (8, -8):
            jump(days * DAY)
            assert abs(server_time(server) - before - days * DAY) < DAY / 2
            time.sleep(2.5)  # several rounds of reaper and retention
            assert (state(ended), state(running), state(waiting)) == (
                "succeeded", "running", "queued",
            )  # fmt: skip
            assert client.head(upload.headers["location"], headers=TUS).status_code == 200
        late = submit("ok.xyz")
        for job_id in (running, waiting, late):
            wait_for(has_state(job_id, "succeeded"), 40, "the end")
            assert client.get(f"/jobs/{job_id}").json()["attempt"] == 1
        assert client.get(f"/jobs/{ended}/mesh.glb").content.startswith(b"glTF")
        assert client.get("/readyz").json()["status"] == "ready"


def server_time(server: Server) -> float:
    redis = Redis.from_url(server.url)
    try:
        return float(redis.time()[0])
    finally:
        redis.close()
