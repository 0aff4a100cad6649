"""Real Valkey, real workers and real clouds for the tests of service and worker."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Protocol, TypeVar

import httpx2
import numpy as np
import pytest
from redis import Redis
from redis.exceptions import RedisError

from service.connection import connect
from service.embedded import EmbeddedValkey, embedded_valkey
from service.settings import Settings

T = TypeVar("T")

PATIENCE = float(os.environ.get("MPF_TEST_PATIENCE", "4"))
"""Times what an idle machine needs; a busy one may be given more."""

REPOSITORY = Path(__file__).resolve().parents[1]


class Server:
    """A Valkey that can be killed and started again over the same folder."""

    def __init__(self, folder: Path):
        self.configured: EmbeddedValkey = embedded_valkey(folder)
        self.url = self.configured.url
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        self._process = subprocess.Popen(self.configured.command)
        redis = Redis.from_url(self.url)
        wait_for(lambda: _pings(redis), 20, "Valkey")
        redis.close()

    def kill(self) -> None:
        assert self._process is not None
        self._process.kill()
        self._process.wait()

    def stop(self) -> None:
        if self._process is not None and self._process.poll() is None:
            self._process.terminate()
            self._process.wait(20)


def _pings(redis: Redis) -> bool:
    try:
        return bool(redis.ping())
    except RedisError:
        return False


def wait_for(look: Callable[[], T], seconds: float, what: str) -> T:
    """Poll until `look` is true; there is no event to await across processes.

    `seconds` is what an idle machine needs; a busy one gets more.
    """
    deadline = time.monotonic() + seconds * PATIENCE
    while True:
        found = look()
        if found:
            return found
        if time.monotonic() > deadline:
            raise AssertionError(f"{what}: not within {seconds} s")
        time.sleep(0.1)


class Startable(Protocol):
    """A process of a test's."""

    def start(self) -> None: ...

    def stop(self) -> None: ...


S = TypeVar("S", bound=Startable)


@contextlib.contextmanager
def running(make: Callable[[Path], S]) -> Iterator[S]:
    """What `make` makes in a folder of its own, started, and stopped afterwards."""
    # Not tmp_path: a unix socket's path must be short.
    with tempfile.TemporaryDirectory(prefix="mpf-") as folder:
        made = make(Path(folder))
        made.start()
        yield made
        made.stop()


@pytest.fixture(scope="session")
def shared_server() -> Iterator[Server]:
    with running(Server) as server:
        yield server


@pytest.fixture
def own_server() -> Iterator[Server]:
    """A Valkey of the test's own, to be killed."""
    with running(Server) as server:
        yield server


@pytest.fixture
def settings(shared_server: Server, tmp_path: Path) -> Iterator[Settings]:
    made = settings_for(shared_server, tmp_path)
    redis = connect(made)
    redis.flushall()
    yield made
    redis.close()


def settings_for(server: Server, folder: Path, **changes: Any) -> Settings:
    """Settings with short times, so that tests are quick."""
    given: dict[str, Any] = {
        "redis_url": server.url,
        "data_dir": folder / "data",
        "heartbeat_seconds": 1.0,
        "job_nice": 0,
        "lease_seconds": 4.0,
        "progress_seconds": 0.05,
        "cancel_poll_seconds": 0.05,
    }
    return Settings(**(given | changes))


@pytest.fixture
def redis(settings: Settings) -> Iterator[Redis]:
    client = connect(settings)
    yield client
    client.close()


def environment(settings: Settings) -> dict[str, str]:
    """The environment that makes a process see these settings."""
    told = {
        f"MPF_{name.upper()}": json.dumps(value) if isinstance(value, tuple) else str(value)
        for name, value in settings.model_dump().items()
        if value is not None
    }
    return os.environ | told | {"PYTHONPATH": str(REPOSITORY)}


@contextlib.contextmanager
def running_worker(
    settings: Settings, module: str = "tests.worker.plumbing"
) -> Iterator[subprocess.Popen[bytes]]:
    """A worker process; its jobs are those of tests/worker/plumbing.py."""
    process = subprocess.Popen([sys.executable, "-m", module], env=environment(settings))
    try:
        yield process
    finally:
        stop(process)


@contextlib.contextmanager
def running_api(settings: Settings) -> Iterator[str]:
    """An API process; its base URL."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen(512)
        listener.set_inheritable(True)
        url = f"http://127.0.0.1:{listener.getsockname()[1]}"
        code = f"from service.cli import api; api(['--fd', '{listener.fileno()}'])"
        process = subprocess.Popen(
            [sys.executable, "-c", code],
            env=environment(settings),
            pass_fds=(listener.fileno(),),
            cwd=REPOSITORY,
        )
    try:
        wait_for(lambda: _live(url), 30, "the API")
        yield url
    finally:
        stop(process)


def _live(url: str) -> bool:
    try:
        return httpx2.get(f"{url}/livez", timeout=1).status_code == 200
    except httpx2.HTTPError:
        return False


def stop(process: subprocess.Popen[bytes]) -> None:
    if process.poll() is None:
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(20)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def tell(figure: str) -> None:
    """Something measured; `pytest -rP` shows it."""
    sys.stdout.write(f"{figure}\n")


def sphere_xyz(count: int = 200, seed: int = 0) -> bytes:
    """A small honest cloud."""
    points = np.random.default_rng(seed).normal(size=(count, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    return "\n".join(" ".join(f"{v:.6f}" for v in row) for row in points).encode() + b"\n"


def form(data: bytes | None = None, name: str = "sphere.xyz", **options: Any) -> dict[str, Any]:
    """Arguments of a client's `post` for a submission."""
    return {
        "files": {"file": (name, sphere_xyz() if data is None else data)},
        "data": {"options": json.dumps(options)},
    }
