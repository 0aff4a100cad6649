"""How quick polls are while others upload and two jobs fit: `python -m tests.load`.

Exits with 1 if a request failed or the 99th percentile is above the target. What is measured is
the clients' time, on the same cores: so it tells as well what they cost, and how much of the
machine was taken by processes that have nothing to do with it.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Any

import httpx2

from service.settings import Settings, usable_cores
from tests.processes import cpu_seconds, descendants_of, machine_seconds
from tests.services import (
    REPOSITORY,
    Server,
    environment,
    form,
    running_api,
    running_worker,
    settings_for,
    wait_for,
)

STARTED = 30.0  # s; jobs must run before anybody asks for them


@dataclass(frozen=True)
class Figures:
    """times: of each poll, sorted, s; errors: answers other than 200 and 202; processor: seconds
    that the API used for each request, polls and uploads together. The rest in cores: what the API,
    the clients, the two jobs, and processes of somebody else took on average."""

    times: list[float]
    errors: list[str]
    uploads: int
    processor: float
    api: float
    clients: float
    jobs: float
    others: float

    def at(self, share: float) -> float:
        """The quantile of the times, s."""
        return self.times[min(int(len(self.times) * share), len(self.times) - 1)]

    def __str__(self) -> str:
        return (
            f"{len(self.times)} polls, p50 {self.at(0.5):.4f} s, p99 {self.at(0.99):.4f} s, "
            f"{self.uploads} uploads, {len(self.errors)} errors, "
            f"{1000 * self.processor:.2f} ms of processor time per request; "
            f"of {usable_cores()} cores the API took {self.api:.2f}, the clients "
            f"{self.clients:.2f}, the jobs {self.jobs:.2f}, others {self.others:.2f}"
        )


def measure(
    server: Server, folder: Path, *, seconds: float, pollers: int, uploaders: int, **changes: Any
) -> Figures:
    """Two workers burn a core each; the rest is for the API."""
    told: dict[str, Any] = {
        "content_check_bytes": 0,
        "progress_seconds": 0.5,
        "job_nice": Settings.model_fields["job_nice"].default,
    }
    settings = settings_for(server, folder, **(told | changes))
    with running_api(settings) as api, running_worker(settings), running_worker(settings):
        jobs = [
            httpx2.post(f"{api}/jobs", timeout=30, **form(name="burn-60.xyz")).json()["id"]
            for _ in range(2)
        ]
        for job in jobs:
            wait_for(lambda url=f"{api}/jobs/{job}": _state(url) == "running", STARTED, "the jobs")
        pids = descendants_of(os.getpid())
        (serving,) = [pid for pid in pids if _runs(pid, "--fd")]
        fitting = [pid for pid in pids if _runs(pid, "plumbing_job")]
        begin = _Spent.now(pids, serving, fitting)
        where = api.removeprefix("http://")
        uploading = _client(settings, "upload", where, seconds, uploaders)
        polling = _client(settings, "poll", where, seconds, pollers, *jobs)
        polls, uploads = _found(polling), _found(uploading)
        spent = _Spent.now(pids, serving, fitting).since(begin)
    requests = len(polls["times"]) + len(uploads["times"])
    clients = polls["processor"] + uploads["processor"]
    return Figures(
        times=sorted(polls["times"]),
        errors=polls["errors"] + uploads["errors"],
        uploads=len(uploads["times"]),
        processor=spent.api / max(requests, 1),
        api=spent.api / spent.clock,
        clients=clients / spent.clock,
        jobs=spent.jobs / spent.clock,
        others=max(0.0, spent.machine - spent.ours - clients) / spent.clock,
    )


@dataclass(frozen=True)
class _Spent:
    """Seconds of the clock, and of processor time: of all the machine, of what was started here
    (but for the clients, which tell it themselves), and of the API and the jobs alone."""

    clock: float
    machine: float
    ours: float
    api: float
    jobs: float

    @classmethod
    def now(cls, pids: list[int], serving: int, fitting: list[int]) -> _Spent:
        return cls(
            time.monotonic(),
            machine_seconds(),
            sum(map(cpu_seconds, pids)),
            cpu_seconds(serving),
            sum(map(cpu_seconds, fitting)),
        )

    def since(self, begin: _Spent) -> _Spent:
        return _Spent(*(a - b for a, b in zip(astuple(self), astuple(begin), strict=True)))


def _state(url: str) -> str:
    return str(httpx2.get(url, timeout=30).json()["state"])


def _runs(pid: int, word: str) -> bool:
    return word in Path(f"/proc/{pid}/cmdline").read_text()


def _client(settings: Settings, *arguments: object) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "tests.load_client", *map(str, arguments)]
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, env=environment(settings), cwd=REPOSITORY
    )


def _found(client: subprocess.Popen[bytes]) -> dict[str, Any]:
    told, _ = client.communicate()
    assert client.returncode == 0
    return dict(json.loads(told))


def main() -> int:
    """Measure with a Valkey, an API and two workers of its own."""
    parser = argparse.ArgumentParser(prog="python -m tests.load", description=__doc__)
    parser.add_argument("--seconds", type=float, default=15.0, help="default: 15")
    parser.add_argument("--pollers", type=int, default=200, help="default: 200")
    parser.add_argument("--uploaders", type=int, default=20, help="default: 20")
    parser.add_argument("--target", type=float, default=0.1, help="of p99, s; default: 0.1")
    asked = parser.parse_args()
    # Not a long path: a unix socket's must be short.
    with tempfile.TemporaryDirectory(prefix="mpf-") as folder:
        server = Server(Path(folder))
        server.start()
        try:
            found = measure(
                server,
                Path(folder),
                seconds=asked.seconds,
                pollers=asked.pollers,
                uploaders=asked.uploaders,
            )
        finally:
            server.stop()
    reached = found.at(0.99) < asked.target
    verdict = "reached" if reached else "not reached"
    sys.stdout.write(f"{found}; target p99 < {asked.target:g} s: {verdict}\n")
    return 0 if reached and not found.errors else 1


if __name__ == "__main__":
    sys.exit(main())
