"""Processes are killed at random moments; every accepted job ends exactly once."""

from __future__ import annotations

import contextlib
import os
import random
import signal
import socket
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import httpx2
import pytest

from service.connection import connect
from service.settings import Settings
from service.supervisor import Child, Supervisor
from tests.processes import alive, children_of
from tests.services import (
    Server,
    environment,
    form,
    running_api,
    settings_for,
    tell,
    wait_for,
)

pytestmark = pytest.mark.slow

SEED = 20


class Workers:
    """Two workers that a supervisor keeps alive, as under `mpf serve`."""

    def __init__(self, settings: Settings, count: int = 2):
        command = [sys.executable, "-m", "tests.worker.plumbing"]
        self.children = [Child(f"worker {n}", command, environment(settings)) for n in range(count)]
        self.supervisor = Supervisor()

    def pids(self) -> list[int]:
        return [c.process.pid for c in self.children if c.process is not None and c.running()]


@contextlib.contextmanager
def supervised(workers: Workers) -> Iterator[Workers]:
    # Children must be started by the main thread (they die with the thread that forked them).
    workers.supervisor.add(*workers.children)
    try:
        yield workers
    finally:
        workers.supervisor.stop()


def submit(api: str, name: str) -> str:
    answer = httpx2.post(f"{api}/jobs", timeout=30, **form(name=name))
    assert answer.status_code == 202, answer.text
    return str(answer.json()["id"])


def states(api: str, ids: list[str]) -> Counter[str]:
    with httpx2.Client(base_url=api, timeout=30) as client:
        return Counter(client.get(f"/jobs/{job_id}").json()["state"] for job_id in ids)


def finish(workers: Workers, done: Callable[[], bool], seconds: float) -> None:
    def look() -> bool:
        workers.supervisor.tick()
        return done()

    wait_for(look, seconds, "all jobs ended")


def kill(pid: int) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)


def test_workers_and_job_processes_killed_at_random(own_server: Server, tmp_path: Path) -> None:
    chance = random.Random(SEED)  # noqa: S311
    settings = settings_for(own_server, tmp_path, content_check_bytes=0, max_attempts=20)
    # Each kind of kill as often, in a random order, at random moments.
    kinds = ["worker", "job", "worker and job"] * 4
    chance.shuffle(kinds)
    with running_api(settings) as api, supervised(Workers(settings)) as workers:
        ids = [submit(api, "long-2.xyz") for _ in range(20)]
        seen: set[int] = set()
        for kind in kinds:
            # From before the process has its lease to after it has told its end.
            wait_for(lambda: _longest_at_work(workers), 40, "a worker at work")
            time.sleep(chance.uniform(0.2, 3.0))
            parent, jobs = wait_for(lambda: _longest_at_work(workers), 40, "a worker at work")
            seen.update(jobs)
            for pid in {"worker": [parent], "job": jobs}.get(kind, [*jobs, parent]):
                kill(pid)
        finish(workers, lambda: states(api, ids)["succeeded"] == 20, 120)
        attempts: Counter[int] = Counter()
        redis = connect(settings)
        for job_id in ids:
            job = httpx2.get(f"{api}/jobs/{job_id}", timeout=20).json()
            attempts[job["attempt"]] += 1
            stream = redis.xrange(f"mpf:job:{job_id}:events")
            assert len([e for _, e in stream if b'"succeeded"' in e[b"data"]]) == 1
            # Only the attempt that counts has left files, and no two were ever at work at once.
            report = httpx2.get(f"{api}{job['artifacts']['report.json']['href']}", timeout=20)
            assert report.json() == {"attempt": job["attempt"]}
            folder = settings.data_dir / "jobs" / job_id
            assert [p.name for p in folder.glob("result-*")] == [f"result-{job['attempt']}"]
            assert not list(folder.glob("work-*"))
            assert not (folder / "two-at-once").exists()
        redis.close()
        assert sum(attempts.values()) == 20
        tell(
            f"20 jobs, {dict(Counter(kinds))} killed; each succeeded once, "
            f"jobs by attempts needed: {dict(sorted(attempts.items()))}"
        )
        assert sum(n * (needed - 1) for needed, n in attempts.items()) >= len(kinds) // 3
        at_work = {pid for parent in workers.pids() for pid in children_of(parent)}
        wait_for(lambda: not any(alive(pid) for pid in seen - at_work), 10, "no orphan left")


def _longest_at_work(workers: Workers) -> tuple[int, list[int]] | None:
    """The worker whose job process was started first, and that process."""
    workers.supervisor.tick()
    busy = []
    for parent in workers.pids():
        with contextlib.suppress(FileNotFoundError):
            if jobs := children_of(parent):
                busy.append((Path(f"/proc/{jobs[0]}").stat().st_ctime, parent, jobs))
    return min(busy)[1:] if busy else None


def test_valkey_killed_while_jobs_are_queued_running_and_submitted(
    own_server: Server, tmp_path: Path
) -> None:
    settings = settings_for(own_server, tmp_path, content_check_bytes=0)
    accepted: list[str] = []
    refused: list[int] = []
    over = threading.Event()

    def keep_submitting(api: str) -> None:
        while not over.wait(0.1):
            with contextlib.suppress(httpx2.TransportError):
                answer = httpx2.post(f"{api}/jobs", timeout=30, **form(name="long-1.xyz"))
                if answer.status_code == 202:
                    accepted.append(answer.json()["id"])
                else:
                    assert answer.json()["code"] == "service.unavailable", answer.text
                    refused.append(answer.status_code)

    with running_api(settings) as api, supervised(Workers(settings)) as workers:
        accepted += [submit(api, "long-1.xyz") for _ in range(4)]
        finish(workers, lambda: states(api, accepted)["running"] > 0, 30)
        submitting = threading.Thread(target=keep_submitting, args=(api,))
        submitting.start()
        for _ in range(2):
            time.sleep(0.7)
            own_server.kill()
            wait_for(lambda: httpx2.get(f"{api}/readyz", timeout=20).status_code == 503, 20, "503")
            missing = httpx2.get(f"{api}/jobs/{accepted[0]}", timeout=20)
            assert missing.json()["code"] == "service.unavailable"
            time.sleep(1.0)
            own_server.start()
            wait_for(
                lambda: httpx2.get(f"{api}/livez", timeout=20).status_code == 200, 20, "recovery"
            )
        time.sleep(1.0)
        over.set()
        submitting.join(40)
        assert refused
        assert len(accepted) > 4
        tell(f"2 kills of Valkey, {len(accepted)} accepted, {len(refused)} answered 503")
        finish(
            workers,
            lambda: states(api, accepted)["succeeded"] == len(accepted),
            60 + len(accepted) * 3,
        )


def test_api_killed_during_uploads_leaves_no_job_and_no_file_for_long(
    own_server: Server, tmp_path: Path
) -> None:
    settings = settings_for(own_server, tmp_path, orphan_seconds=1.0, retention_round_seconds=0.5)
    with running_api(settings) as api:
        host, _, port = api.removeprefix("http://").partition(":")
        uploads = []
        for _ in range(5):
            connection = socket.create_connection((host, int(port)))
            connection.sendall(
                b"POST /jobs HTTP/1.1\r\nHost: localhost\r\nContent-Length: 2000000\r\n"
                b"Content-Type: multipart/form-data; boundary=b\r\n\r\n--b\r\n"
                b'Content-Disposition: form-data; name="file"; filename="a.xyz"\r\n\r\n'
                + b"0.1 0.2 0.3\n"
                * 60_000
            )
            uploads.append(connection)
        folder = settings.data_dir / "uploads"
        wait_for(lambda: len(list(folder.glob("*"))) == 5, 20, "uploads on their way")
        for pid in _listeners(int(port)):
            kill(pid)
        for connection in uploads:
            connection.close()
    assert len(list(folder.glob("*"))) == 5
    with running_api(settings) as api, supervised(Workers(settings, 1)) as workers:
        assert httpx2.get(f"{api}/jobs", timeout=20).json()["jobs"] == []
        finish(workers, lambda: not list(folder.glob("*")), 30)


def _listeners(port: int) -> list[int]:
    """Children of this process that have a socket at `port` open: the API."""
    return [
        pid
        for pid in children_of(os.getpid())
        if "--fd" in Path(f"/proc/{pid}/cmdline").read_text()
    ]
