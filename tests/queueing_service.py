"""A real service with one worker, for benchmarks/queueing.py.

All is real but the fit: a job's process starts, works for two seconds, and publishes.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from statistics import fmean

import httpx2

from tests.services import (
    Server,
    form,
    running_api,
    running_worker,
    settings_for,
)

CLOUD = "long-2.xyz"
"""Works for two seconds (tests/worker/plumbing.py)."""


@dataclass
class Service:
    """Where it is, and how long a job takes that finds the worker free, s."""

    url: str
    alone: float = 0.0


@contextmanager
def one_worker() -> Iterator[Service]:
    """Valkey, API and one worker."""
    with tempfile.TemporaryDirectory(prefix="mpf-") as folder:
        server = Server(Path(folder) / "valkey")
        server.start()
        settings = settings_for(server, Path(folder), content_check_bytes=0)
        try:
            with running_api(settings) as url, running_worker(settings):
                service = Service(url)
                ended(service, [submit(service)])  # what it loads is in the cache now
                lone = [ended(service, [submit(service)])[0] for _ in range(3)]
                service.alone = fmean(job["finished"] - job["created"] for job in lone)
                yield service
        finally:
            server.stop()


def submit(service: Service) -> str:
    answer = httpx2.post(f"{service.url}/jobs", timeout=30, **form(name=CLOUD))
    assert answer.status_code == 202, answer.text
    return str(answer.json()["id"])


def ended(service: Service, ids: Sequence[str]) -> list[dict[str, float]]:
    """When each was created, started and finished, once all have ended; s.

    Looks seldom and at one job at a time: who measures must not keep the processor busy.
    """
    jobs = []
    with httpx2.Client(base_url=service.url, timeout=90) as client:
        for job_id in ids:
            while not (job := client.get(f"/jobs/{job_id}", params={"wait": 30}).json())[
                "finished_at"
            ]:
                pass
            jobs.append(job)
    assert {job["state"] for job in jobs} == {"succeeded"}, jobs
    return [
        {what: _seconds(job[f"{what}_at"]) for what in ("created", "started", "finished")}
        for job in jobs
    ]


def occupied(service: Service, count: int) -> list[float]:
    """How long each of `count` jobs that wait together keeps the worker from the next one, s."""
    found = sorted(ended(service, [submit(service) for _ in range(count)]),
                   key=lambda job: job["started"])  # fmt: skip
    return [b["started"] - a["started"] for a, b in pairwise(found)]


def waits(service: Service, moments: Sequence[float]) -> list[float]:
    """For how long jobs waited for the worker that were submitted at these moments, s."""
    begin = time.monotonic()
    ids = []
    for moment in moments:
        time.sleep(max(0.0, begin + moment - time.monotonic()))
        ids.append(submit(service))
    return [job["finished"] - job["created"] - service.alone for job in ended(service, ids)]


def _seconds(text: str) -> float:
    return datetime.fromisoformat(text).timestamp()
