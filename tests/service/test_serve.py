"""`mpf serve` as a user starts it: one command, real processes, killed in every way."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import stat
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import httpx2
import pytest

from tests.processes import alive, children_of
from tests.services import REPOSITORY, form, stop, wait_for

SERVING = re.compile(r'serving on (http://[^\s"]+)')


class Serving:
    """A running `mpf serve`."""

    def __init__(self, data_dir: Path):
        self.log = data_dir.parent / f"{data_dir.name}.log"
        command = [sys.executable, "-m", "mpf_core", "serve", "--port", "0", "--workers", "2"]
        environment = os.environ | {"PYTHONPATH": str(REPOSITORY)}
        with self.log.open("wb") as log:
            self.process = subprocess.Popen(
                [*command, "--data-dir", str(data_dir)], stderr=log, env=environment
            )
        self.url = wait_for(self._url, 40, "mpf serve")
        self.client = httpx2.Client(base_url=self.url, timeout=60)

    def _url(self) -> str | None:
        assert self.process.poll() is None, self.log.read_text()
        found = SERVING.search(self.log.read_text())
        return found.group(1) if found else None

    def status(self) -> str:
        with contextlib.suppress(httpx2.HTTPError):
            return str(self.client.get("/readyz").json()["status"])
        return "away"

    def until_ready(self) -> None:
        wait_for(lambda: self.status() == "ready", 40, "ready")

    def child(self, words: str) -> int:
        for pid in children_of(self.process.pid):
            with contextlib.suppress(FileNotFoundError):
                line = Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode()
                if words in line:
                    return pid
        raise AssertionError(f"no child {words}")


@contextlib.contextmanager
def serving(data_dir: Path) -> Iterator[Serving]:
    found = Serving(data_dir)
    try:
        yield found
    finally:
        found.client.close()
        stop(found.process)


@pytest.fixture
def data_dir() -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix="mpf-") as folder:
        yield Path(folder) / "data"


def test_neither_api_nor_worker_loads_torch(data_dir: Path) -> None:
    with serving(data_dir) as service:
        service.until_ready()
        for words in (" api ", " worker "):
            maps = Path(f"/proc/{service.child(words)}/maps").read_text()
            assert "libtorch" not in maps
        for secret in ("password", "valkey.conf"):
            mode = (data_dir / "valkey" / secret).stat().st_mode
            assert stat.S_IMODE(mode) == 0o600


def test_dead_children_are_restarted_and_a_restart_finds_every_job(data_dir: Path) -> None:
    with serving(data_dir) as service:
        service.until_ready()
        job = service.client.post("/jobs", **form(preset="draft")).json()["id"]
        for words in (" api ", "valkey-server", " worker "):
            os.kill(service.child(words), signal.SIGKILL)
        wait_for(lambda: service.status() == "away" or service.child(" api "), 10, "killed")
        service.until_ready()
        assert service.client.get(f"/jobs/{job}").status_code == 200
        children = children_of(service.process.pid)
        assert len(children) == 4
        service.process.send_signal(signal.SIGINT)
        assert service.process.wait(40) == 0
        assert not any(alive(pid) for pid in children)
    with serving(data_dir) as service:
        assert service.client.get(f"/jobs/{job}").status_code == 200


def test_a_killed_supervisor_leaves_nothing_behind(data_dir: Path) -> None:
    with serving(data_dir) as service:
        service.until_ready()
        children = children_of(service.process.pid)
        service.process.kill()
        wait_for(lambda: not any(alive(pid) for pid in children), 30, "children gone")


def test_what_cannot_be_served_is_said_in_one_sentence(data_dir: Path) -> None:
    def refused(*arguments: str) -> str:
        done = subprocess.run(
            [sys.executable, "-m", "mpf_core", "serve", "--data-dir", str(data_dir), *arguments],
            capture_output=True, text=True, timeout=40, cwd=REPOSITORY,
        )  # fmt: skip
        assert done.returncode == 1
        assert "Traceback" not in done.stderr
        return done.stderr

    assert "API keys" in refused("--host", "0.0.0.0")  # noqa: S104
    with serving(data_dir) as service:
        assert "Another `mpf serve`" in refused("--port", "0")
        port = service.url.rpartition(":")[2]
        other = str(data_dir.parent / "other")
        assert f"Port {port}" in refused("--port", port, "--data-dir", other)
