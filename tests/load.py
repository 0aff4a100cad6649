"""How quick polls are while others upload and two jobs fit: `python -m tests.load`.

Exits with 1 if a request failed or the 99th percentile is above the target.
"""

from __future__ import annotations

import argparse
import asyncio
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import httpx2

from service.settings import Settings
from tests.services import (
    Server,
    form,
    running_api,
    running_worker,
    settings_for,
    sphere_xyz,
)

POLL_EVERY = 2.0  # what Retry-After says


@dataclass(frozen=True)
class Figures:
    """times: of each poll, sorted, s; errors: answers other than 200 and 202."""

    times: list[float]
    errors: list[str]
    uploads: int

    def at(self, share: float) -> float:
        """The quantile of the times, s."""
        return self.times[min(int(len(self.times) * share), len(self.times) - 1)]

    def __str__(self) -> str:
        return (
            f"{len(self.times)} polls, p50 {self.at(0.5):.4f} s, p99 {self.at(0.99):.4f} s, "
            f"{self.uploads} uploads, {len(self.errors)} errors"
        )


def measure(
    server: Server, folder: Path, *, seconds: float, pollers: int, uploaders: int
) -> Figures:
    """Two workers burn a core each; the rest is for the API."""
    settings = settings_for(
        server,
        folder,
        content_check_bytes=0,
        progress_seconds=0.5,
        job_nice=Settings.model_fields["job_nice"].default,
    )
    with running_api(settings) as api, running_worker(settings), running_worker(settings):
        jobs = [
            httpx2.post(f"{api}/jobs", timeout=30, **form(name="burn-30.xyz")).json()["id"]
            for _ in range(2)
        ]
        return asyncio.run(press(api, jobs, seconds=seconds, pollers=pollers, uploaders=uploaders))


async def press(
    api: str, jobs: list[str], *, seconds: float, pollers: int, uploaders: int
) -> Figures:
    """Poll `jobs` and upload clouds for so long."""
    times: list[float] = []
    errors: list[str] = []
    uploaded = 0
    over = time.monotonic() + seconds
    limits = httpx2.Limits(max_connections=None, max_keepalive_connections=None)
    cloud = sphere_xyz(20_000)

    async def poll(client: httpx2.AsyncClient, number: int) -> None:
        await asyncio.sleep(POLL_EVERY * number / pollers)
        while time.monotonic() < over:
            start = time.perf_counter()
            answer = await client.get(f"/jobs/{jobs[number % 2]}")
            times.append(time.perf_counter() - start)
            if answer.status_code != 200:
                errors.append(answer.text)
            await asyncio.sleep(POLL_EVERY)

    async def upload(client: httpx2.AsyncClient) -> None:
        nonlocal uploaded
        while time.monotonic() < over:
            answer = await client.post("/jobs", **form(cloud, name="ok.xyz"))
            uploaded += 1
            if answer.status_code != 202:
                errors.append(answer.text)
            await asyncio.sleep(1.0)

    async with (
        httpx2.AsyncClient(base_url=api, limits=limits, timeout=30) as client,
        asyncio.TaskGroup() as group,
    ):
        for number in range(pollers):
            group.create_task(poll(client, number))
        for _ in range(uploaders):
            group.create_task(upload(client))
    return Figures(sorted(times), errors, uploaded)


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
