"""Real object stores for tests: two implementations of S3 and one of Azure's, each a process on
loopback."""

from __future__ import annotations

import os
import secrets
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import boto3
import pytest
from botocore.config import Config

from service.connection import connect
from service.settings import Settings
from tests.services import Server, running, settings_for, wait_for

KEY, SECRET = "mpf-test-key", "mpf-test-secret"


class ObjectStore:
    """One server; `stop` and `start` again find the same objects in rclone's, none in moto's."""

    scheme = "s3"
    secret = SECRET

    def __init__(self, kind: str, folder: Path, host: str = "127.0.0.1", port: int = 0):
        self.kind = kind
        self.folder = folder
        self.host = host
        self.port = port or _free_port()
        self.url = f"http://{host}:{self.port}"
        self._process: subprocess.Popen[bytes] | None = None

    def command(self) -> list[str]:
        bin_ = Path(sys.executable).parent
        if self.kind == "moto":
            return [str(bin_ / "moto_server"), "-H", self.host, "-p", str(self.port)]
        return [str(bin_ / "rclone"), "serve", "s3", str(self.folder), "--addr",
                f"{self.host}:{self.port}", "--auth-key", f"{KEY},{SECRET}",
                "--config", "/dev/null"]  # fmt: skip

    def start(self) -> None:
        quiet = subprocess.DEVNULL
        self._process = subprocess.Popen(
            self.command(), stdout=quiet, stderr=quiet, env=os.environ | self.own_environment()
        )
        wait_for(self.answers, 30, f"the {self.kind} store")

    def answers(self) -> bool:
        with suppress(OSError):
            socket.create_connection((self.host, self.port), 1).close()
            return True
        return False

    def stop(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()

    def own_environment(self) -> dict[str, str]:
        """What the server wants to find."""
        return {}

    def environment(self) -> dict[str, str]:
        """What the service wants to find."""
        return {
            "AWS_ACCESS_KEY_ID": KEY,
            "AWS_SECRET_ACCESS_KEY": SECRET,
            "AWS_REGION": "us-east-1",
            "AWS_ENDPOINT_URL": self.url,
        }

    def away(self) -> dict[str, str]:
        """Of that, what names a place where no server is."""
        return {"AWS_ENDPOINT_URL": "http://127.0.0.1:9"}

    def client(self) -> Any:
        return boto3.client(
            "s3", endpoint_url=self.url, aws_access_key_id=KEY, aws_secret_access_key=SECRET,
            region_name="us-east-1", config=Config(retries={"max_attempts": 2}),
        )  # fmt: skip

    def new_bucket(self) -> str:
        name = f"mpf-{secrets.token_hex(4)}"
        self.client().create_bucket(Bucket=name)
        return name

    def keys(self, bucket: str) -> set[str]:
        pages = self.client().get_paginator("list_objects_v2").paginate(Bucket=bucket)
        return {found["Key"] for page in pages for found in page.get("Contents", [])}


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture(scope="session")
def moto() -> Iterator[ObjectStore]:
    with running(partial(ObjectStore, "moto")) as store:
        yield store


@pytest.fixture(scope="session")
def rclone() -> Iterator[ObjectStore]:
    with running(partial(ObjectStore, "rclone")) as store:
        yield store


class Place:
    """A bucket of a store, and settings that name it; the environment has its credentials."""

    def __init__(self, store: ObjectStore, server: Server, folder: Path, **changes: Any):
        self.store = store
        self.bucket = store.new_bucket()
        url = f"{store.scheme}://{self.bucket}/some/prefix"
        self.settings: Settings = settings_for(server, folder, store_url=url, **changes)

    def objects(self) -> set[str]:
        """What lies below the prefix."""
        return {key.removeprefix("some/prefix/") for key in self.store.keys(self.bucket)}

    def of(self, job_id: str) -> set[str]:
        """The objects of a job."""
        start = f"jobs/{job_id}/"
        return {key.removeprefix(start) for key in self.objects() if key.startswith(start)}


SLOW = [pytest.param(name, marks=pytest.mark.slow) for name in ("rclone", "azurite")]


@pytest.fixture(params=["moto", *SLOW])
def place(
    request: pytest.FixtureRequest,
    shared_server: Server,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> Place:
    store: ObjectStore = request.getfixturevalue(request.param)
    for name, value in store.environment().items():
        monkeypatch.setenv(name, value)
    made = Place(store, shared_server, tmp_path)
    redis = connect(made.settings)
    redis.flushall()
    redis.close()
    return made
