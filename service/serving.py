"""`mpf serve`: Valkey, the API and the workers of one machine under one supervisor."""

from __future__ import annotations

import fcntl
import ipaddress
import logging
import os
import socket
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from redis.exceptions import RedisError

from service.access.store import KeyStore
from service.connection import connect, require_noeviction
from service.embedded import embedded_valkey, running_url
from service.logs import configure_logging
from service.settings import Settings
from service.supervisor import Child, Supervisor

log = logging.getLogger("mpf.serve")

START_SECONDS = 60.0
"""How long Valkey may take to read its file, and the API to answer."""

WORKER_STOP_SECONDS = 30.0
"""A worker hands its job back first."""


class CannotServe(Exception):
    """str() says why and what to do."""


@dataclass(frozen=True)
class Plan:
    """What to serve, and where."""

    host: str
    port: int
    data_dir: Path
    workers: int
    redis_url: str | None
    """A server that is already there; None: bring one along."""


def serve(plan: Plan) -> None:
    """Run until Ctrl-C or SIGTERM; a restart finds every job again."""
    configure_logging()
    plan.data_dir.mkdir(parents=True, exist_ok=True)
    with _exclusive(plan.data_dir), _listening(plan.host, plan.port) as listener:
        supervisor = Supervisor()
        supervisor.listen()
        try:
            environment = _start_redis(plan, supervisor)
            _require_keys_beyond_loopback(plan, environment, supervisor)
            supervisor.add(_api(listener, environment), *_workers(plan, environment))
            _announce(listener, supervisor)
            supervisor.run()
        finally:
            log.info("stopping")
            supervisor.stop()


def _start_redis(plan: Plan, supervisor: Supervisor) -> dict[str, str]:
    """Start Valkey if one must be brought along; the environment of the other children."""
    url = plan.redis_url
    if url is None:
        valkey = embedded_valkey(plan.data_dir)
        url = valkey.url
        supervisor.add(Child("valkey", valkey.command, stop_seconds=20.0))
    settings = Settings(redis_url=url, data_dir=plan.data_dir, workers=plan.workers)
    _wait_for_redis(settings, supervisor)
    return {
        "MPF_REDIS_URL": url,
        "MPF_DATA_DIR": str(plan.data_dir.resolve()),
        "MPF_WORKERS": str(plan.workers),
    }


def _require_keys_beyond_loopback(
    plan: Plan, environment: dict[str, str], supervisor: Supervisor
) -> None:
    if is_loopback(plan.host) or supervisor.stopping:
        return
    require_a_key(plan.host, Settings(redis_url=environment["MPF_REDIS_URL"]))
    environment["MPF_REQUIRE_KEYS"] = "1"


def require_a_key(host: str, settings: Settings) -> None:
    """Refuse to be reachable from elsewhere while there are no keys to ask for."""
    redis = connect(settings)
    try:
        if not KeyStore(redis).any_valid():
            raise CannotServe(
                f"{host} can be reached from other machines, and there are no API keys: anybody "
                "could run jobs and read results. Make one with `mpf keys create NAME`, or listen "
                "on 127.0.0.1."
            )
    finally:
        redis.close()


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach `host`."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


@contextmanager
def embedded_running(data_dir: Path, redis_url: str | None) -> Iterator[str]:
    """The URL of the Redis that belongs to `data_dir`, started for the while if it is not there."""
    if redis_url is not None:
        yield redis_url
        return
    running = running_url(data_dir)
    if running is not None:
        yield running
        return
    data_dir.mkdir(parents=True, exist_ok=True)
    with _exclusive(data_dir):
        supervisor = Supervisor()
        valkey = embedded_valkey(data_dir)
        supervisor.add(Child("valkey", valkey.command, stop_seconds=20.0))
        try:
            _wait_for_redis(Settings(redis_url=valkey.url), supervisor)
            yield valkey.url
        finally:
            supervisor.stop()


def _wait_for_redis(settings: Settings, supervisor: Supervisor) -> None:
    redis = connect(settings)
    deadline = time.monotonic() + START_SECONDS
    while not supervisor.stopping:
        try:
            redis.ping()
            break
        except RedisError as error:
            if time.monotonic() > deadline:
                raise CannotServe(
                    f"Redis at {settings.redis_safe_url()} does not answer: {error}"
                ) from error
        supervisor.tick()
        time.sleep(0.05)
    if not supervisor.stopping:
        require_noeviction(redis)
    redis.close()


def _api(listener: socket.socket, environment: dict[str, str]) -> Child:
    """The socket is the supervisor's: while the API restarts, callers wait and are not refused."""
    descriptor = listener.fileno()
    command = _mpf("api", "--fd", str(descriptor))
    return Child("api", command, environment, pass_fds=(descriptor,))


def _workers(plan: Plan, environment: dict[str, str]) -> list[Child]:
    return [
        Child(
            f"worker {n + 1}",
            _mpf("worker"),
            environment | {"MPF_WORKER_INDEX": str(n)},
            stop_seconds=WORKER_STOP_SECONDS,
        )
        for n in range(plan.workers)
    ]


def _mpf(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "mpf_core", *arguments]


def _announce(listener: socket.socket, supervisor: Supervisor) -> None:
    """Say where the service is once it answers; scripts wait for this line."""
    host, port = listener.getsockname()[:2]
    deadline = time.monotonic() + START_SECONDS
    while not supervisor.stopping and time.monotonic() < deadline:
        if _answers(host, port):
            log.info("serving on http://%s:%s", f"[{host}]" if ":" in host else host, port)
            return
        supervisor.tick()
        time.sleep(0.05)


def _answers(host: str, port: int) -> bool:
    request = b"GET /livez HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n"
    reach = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host)  # noqa: S104
    try:
        with socket.create_connection((reach, port), timeout=1.0) as probe:
            probe.sendall(request)
            return b" 200 " in probe.recv(64)
    except OSError:
        return False


def _listening(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listener = socket.socket(family)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((host, port))
    except OSError as error:
        listener.close()
        raise CannotServe(f"Port {port} of {host} cannot be used: {error.strerror}.") from error
    listener.listen(2048)
    listener.set_inheritable(True)
    return listener


class _exclusive:  # noqa: N801  reads as a statement
    """Only one `mpf serve` per data folder."""

    def __init__(self, data_dir: Path):
        self._path = data_dir / "serve.lock"
        self._file: IO[str] | None = None

    def __enter__(self) -> None:
        self._file = self._path.open("a")
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            self._file.close()
            raise CannotServe(
                f"Another `mpf serve` (or its Valkey) works in {self._path.parent}."
            ) from error
        os.set_inheritable(self._file.fileno(), False)

    def __exit__(self, *_: object) -> None:
        if self._file is not None:
            self._file.close()
