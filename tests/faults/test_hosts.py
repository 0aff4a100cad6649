"""API ×2, workers ×3, Valkey and an S3 store, each at an address of its own: a link is cut and
restored, a replica killed, Valkey killed. Every accepted job ends once, with its result."""

from __future__ import annotations

import contextlib
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import boto3
import httpx2
import pytest
from redis import Redis
from redis.exceptions import RedisError

from service.access.store import KeyStore
from service.client import Client, Job
from service.embedded import find_binary
from service.jobs.model import JobState
from service.jobs.store import JobStore
from tests.hosts import Host, Network, NotAllowed, network
from tests.processes import children_of
from tests.services import REPOSITORY, sphere_xyz, tell, wait_for

pytestmark = pytest.mark.slow

PASSWORD, KEY, SECRET = "of-valkey", "mpf-test-key", "mpf-test-secret"
JOBS = 30


class Service:
    """The parts on their hosts."""

    def __init__(self, net: Network, folder: Path):
        self.folder = folder
        self.valkey = net.add("valkey")
        self.store = net.add("store")
        self.apis = [net.add(f"api{n}") for n in (1, 2)]
        self.workers = [net.add(f"worker{n}") for n in (1, 2, 3)]
        self.redis_url = f"redis://:{PASSWORD}@{self.valkey.address}:6379/0"
        self.processes: dict[str, Any] = {}
        for host in net.hosts.values():
            (folder / host.name).mkdir()

    def environment(self, host: Host) -> dict[str, str]:
        return {
            "PYTHONPATH": str(REPOSITORY),
            "MPF_REDIS_URL": self.redis_url,
            "MPF_STORE_URL": "s3://jobs/mpf",
            "MPF_DATA_DIR": str(self.folder / host.name),
            "MPF_LEASE_SECONDS": "4",
            "MPF_CONTENT_CHECK_BYTES": "0",
            "MPF_PROGRESS_SECONDS": "0.2",
            "AWS_ENDPOINT_URL": f"http://{self.store.address}:9000",
            "AWS_ACCESS_KEY_ID": KEY,
            "AWS_SECRET_ACCESS_KEY": SECRET,
            "AWS_REGION": "us-east-1",
        }

    def log(self, host: Host) -> Path:
        return self.folder / f"{host.name}.log"

    def start(self, host: Host, *command: str) -> None:
        self.processes[host.name] = host.start(command, self.environment(host), self.log(host))

    def start_valkey(self) -> None:
        self.start(
            self.valkey, str(find_binary()), "--bind", self.valkey.address, "--port", "6379",
            "--requirepass", PASSWORD, "--appendonly", "yes", "--appendfsync", "always",
            "--save", "", "--maxmemory-policy", "noeviction",
            "--dir", str(self.folder / self.valkey.name),
        )  # fmt: skip
        wait_for(self.redis_answers, 20, "Valkey")

    def redis_answers(self) -> bool:
        try:
            with contextlib.closing(self.redis()) as redis:
                return bool(redis.ping())
        except RedisError:
            return False

    def redis(self) -> Redis:
        return Redis.from_url(self.redis_url, socket_connect_timeout=1.0, socket_timeout=2.0)

    def start_store(self) -> None:
        moto = Path(sys.executable).parent / "moto_server"
        self.start(self.store, str(moto), "-H", self.store.address, "-p", "9000")
        url = f"http://{self.store.address}:9000"
        wait_for(lambda: _answers(url), 30, "the store")
        boto3.client(
            "s3", endpoint_url=url, aws_access_key_id=KEY, aws_secret_access_key=SECRET,
            region_name="us-east-1",
        ).create_bucket(Bucket="jobs")  # fmt: skip

    def start_api(self, host: Host) -> None:
        self.start(
            host, sys.executable, "-m", "mpf_core", "api", "--host", host.address, "--port", "8000"
        )  # fmt: skip
        wait_for(lambda: _answers(f"{self.url(host)}/livez"), 40, host.name)

    def url(self, host: Host) -> str:
        return f"http://{host.address}:8000"

    def start_worker(self, host: Host) -> None:
        self.start(host, sys.executable, "-m", "tests.worker.plumbing")

    def job_of(self, host: Host) -> str:
        """The job that the worker on this host is running, or ""."""
        with contextlib.suppress(FileNotFoundError, ProcessLookupError, PermissionError):
            for pid in children_of(self.processes[host.name].pid):
                told = Path(f"/proc/{pid}/environ").read_bytes().split(b"\0")
                for entry in told:
                    if entry.startswith(b"RQ_JOB_ID="):
                        return entry.decode().partition("=")[2].rpartition("-")[0]
        return ""


def _answers(url: str) -> bool:
    try:
        return httpx2.get(url, timeout=1).status_code < 500
    except httpx2.HTTPError:
        return False


@pytest.fixture
def service(tmp_path: Path) -> Iterator[Service]:
    """All of it running, seen from a client's host."""
    try:
        with network() as net:
            made = Service(net, tmp_path)
            client = net.add("client")
            with net.seen_from(client):
                made.start_valkey()
                made.start_store()
                yield made
    except NotAllowed as reason:
        pytest.skip(f"this user cannot make network namespaces: {reason}")


@pytest.mark.timeout(240)
def test_jobs_on_several_hosts_through_cuts_and_kills(service: Service, tmp_path: Path) -> None:
    with contextlib.closing(service.redis()) as redis:
        _, secret = KeyStore(redis).create("test")
    for host in service.apis:
        service.start_api(host)
    begin = time.monotonic()
    cloud = tmp_path / "long-1.xyz"
    longest = tmp_path / "long-6.xyz"
    for path in (cloud, longest):
        path.write_bytes(sphere_xyz())
    one, two = (Client(service.url(host), secret, patience=40.0) for host in service.apis)
    ids = [one.submit(longest).id for _ in range(3)]
    for host in service.workers:
        service.start_worker(host)
    ids += [(one, two)[n % 2].submit(cloud).id for n in range(12)]

    lost = service.workers[0]
    cut_off = wait_for(lambda: service.job_of(lost), 30, "a job on the first worker")
    wait_for(lambda: two.job(cut_off).state == "running", 20, "it runs")
    lost.cut()
    old = service.processes[lost.name].pid
    taken = wait_for(lambda: elsewhere(two, cut_off), 30, "another worker has taken the job")
    assert service.job_of(lost) == cut_off, "the first one still works on it"

    service.processes[service.apis[0].name].kill()
    ids += [two.submit(cloud).id for n in range(JOBS - len(ids))]
    lost.restore()

    service.processes[service.valkey.name].kill()
    service.processes[service.valkey.name].wait()
    assert httpx2.get(f"{service.url(service.apis[1])}/readyz", timeout=20).status_code == 503
    service.start_valkey()

    wait_for(lambda: all_ended(service, ids), 90, "all jobs")
    jobs = [two.job(job_id) for job_id in ids]
    assert {job.state for job in jobs} == {JobState.SUCCEEDED}
    each_has_its_result_once(service, two, jobs, tmp_path)
    assert two.job(cut_off).attempt >= taken.attempt > 1
    words = service.log(lost).read_text()
    told = [line for line in words.splitlines() if cut_off in line]
    late = ("the lease is lost", "is over already", "fenced")
    wait_for(lambda: service.job_of(lost) != cut_off, 20, "the late one has ended")
    assert any(word in line for line in told for word in late), words
    assert os.path.exists(f"/proc/{old}"), "the worker itself lives on"  # noqa: PTH110
    attempts = sum(job.attempt for job in jobs)
    tell(f"{JOBS} jobs, {attempts} attempts, {time.monotonic() - begin:.0f} s")


def elsewhere(client: Client, job_id: str) -> Job | None:
    job = client.job(job_id)
    return job if job.attempt > 1 and job.state in ("running", "succeeded") else None


def all_ended(service: Service, ids: list[str]) -> bool:
    with contextlib.closing(service.redis()) as redis:
        store = JobStore(redis, retention_seconds=1)
        found = [store.get(job_id) for job_id in ids]
    return all(job is not None and job.ended for job in found)


def each_has_its_result_once(
    service: Service, client: Client, jobs: list[Job], folder: Path
) -> None:
    with contextlib.closing(service.redis()) as redis:
        for job in jobs:
            stream: Any = redis.xrange(f"mpf:job:{job.id}:events")
            ends = [e for _, e in stream if b'"succeeded"' in e[b"data"]]
            assert len(ends) == 1, job.id
            report = folder / "report.json"
            client.download(job, "report.json", report)  # by a link to the store
            # The files are those of the attempt that counts, whoever published what besides.
            assert report.read_text() == f'{{"attempt": {job.attempt}}}'
        assert redis.zcard("mpf:jobs:in:running") == 0
        assert redis.zcard("mpf:jobs:in:queued") == 0
