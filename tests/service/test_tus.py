"""Uploads in pieces: the protocol's own client, lost connections, killed processes, bad manners."""

from __future__ import annotations

import base64
import hashlib
import io
import os
import socket
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx2
import pytest
from redis import Redis
from starlette.testclient import TestClient
from tusclient.client import TusClient

from service.access.store import KeyStore
from service.app import create_app
from service.operations.retention import Retention
from service.settings import Settings
from service.uploads.tus import PIECE_TYPE
from tests.processes import children_of
from tests.services import running_api, sphere_xyz, wait_for

TUS = {"Tus-Resumable": "1.0.0"}
PIECE = TUS | {"Content-Type": PIECE_TYPE}
CLOUD = sphere_xyz(4000)


@pytest.fixture
def quick(settings: Settings) -> Settings:
    return settings.model_copy(update={"content_check_bytes": 0, "upload_bytes": 2_000_000})


@pytest.fixture
def client(quick: Settings) -> Iterator[TestClient]:
    with TestClient(create_app(quick), base_url="http://localhost") as made:
        yield made


def begin(client: Any, length: int = len(CLOUD), name: str = "a b.xyz", **headers: str) -> str:
    named = {"Upload-Metadata": f"filename {base64.b64encode(name.encode()).decode()}"}
    told = TUS | named | {"Upload-Length": str(length)} | headers
    answer = client.post("/uploads", headers=told)
    assert answer.status_code == 201, answer.text
    return str(answer.headers["location"])


def send(client: Any, url: str, offset: int, data: bytes, **headers: str) -> Any:
    told = PIECE | {"Upload-Offset": str(offset)} | headers
    return client.patch(url, headers=told, content=data)


def code(answer: Any) -> tuple[int, str]:
    return answer.status_code, answer.json()["code"]


def cut_off(api: str, url: str, offset: int, data: bytes, sent: int) -> socket.socket:
    """A piece of which only `sent` bytes leave; the connection stays open."""
    host, _, port = api.removeprefix("http://").partition(":")
    connection = socket.create_connection((host, int(port)))
    head = f"PATCH {url} HTTP/1.1\r\nHost: localhost\r\nContent-Length: {len(data)}\r\n"
    head += f"Upload-Offset: {offset}\r\n"
    head += "".join(f"{name}: {value}\r\n" for name, value in PIECE.items())
    connection.sendall(head.encode() + b"\r\n" + data[:sent])
    return connection


def offset_of(api: str, url: str) -> int:
    return int(httpx2.head(f"{api}{url}", headers=TUS, timeout=20).headers["upload-offset"])


def test_an_upload_goes_on_after_a_cut_connection_and_a_killed_api(quick: Settings) -> None:
    data = CLOUD
    third = len(data) // 3
    with running_api(quick) as api:
        tus = TusClient(f"{api}/uploads")
        first = tus.uploader(
            file_stream=io.BytesIO(data), chunk_size=third // 2, metadata={"filename": "s.xyz"}
        )
        first.upload(stop_at=third)
        url = first.url.removeprefix(api)
        assert first.offset == offset_of(api, url)
        lost = cut_off(api, url, first.offset, data[first.offset :], 20_000)
        wait_for(lambda: offset_of(api, url) == first.offset + 20_000, 10, "what was sent counts")
        assert code(send(httpx2, f"{api}{url}", first.offset, b"")) == (423, "upload.locked")
        lost.close()
        wait_for(lambda: not _locked(api, url), 10, "the lock is given back")
        part = quick.data_dir / "resumable" / url.rpartition("/")[2] / "data"
        at = part.stat().st_size
        lost = cut_off(api, url, at, data[at:], len(data) - at - 1)
        wait_for(lambda: offset_of(api, url) == len(data) - 1, 10, "the piece on its way")
        (pid,) = [p for p in children_of(os.getpid()) if "--fd" in _command(p)]
        os.kill(pid, 9)
        lost.close()
    assert part.read_bytes() == data[: part.stat().st_size]
    with running_api(quick) as api:
        second = TusClient(f"{api}/uploads").uploader(
            file_stream=io.BytesIO(data), chunk_size=50_000, url=f"{api}{url}"
        )
        assert second.offset == len(data) - 1
        second.upload()
        answer = httpx2.post(
            f"{api}/jobs", json={"upload": url, "options": {"seed": 3}, "label": "x"}, timeout=20
        )
        assert answer.status_code == 202, answer.text
        job = answer.json()
        assert job["input"]["sha256"] == hashlib.sha256(data).hexdigest()
        assert (job["input"]["name"], job["options"]["seed"], job["label"]) == ("s.xyz", 3, "x")
    assert not list((quick.data_dir / "resumable").iterdir())
    assert (quick.data_dir / "jobs" / job["id"] / "input.xyz").read_bytes() == data


def _command(pid: int) -> str:
    return Path(f"/proc/{pid}/cmdline").read_text()


def _locked(api: str, url: str) -> bool:
    at = offset_of(api, url)
    return bool(send(httpx2, f"{api}{url}", at, b"").status_code == 423)


def test_the_service_tells_what_it_speaks(client: TestClient) -> None:
    told = client.options("/uploads").headers
    assert told["tus-version"] == "1.0.0"
    assert {"creation", "termination", "checksum", "expiration"} == set(
        told["tus-extension"].split(",")
    )
    assert told["tus-max-size"] == "2000000"
    assert client.get("/capabilities").json()["uploads"]["href"] == "/uploads"
    other = client.post("/uploads", headers={"Tus-Resumable": "0.2.2", "Upload-Length": "1"})
    assert code(other) == (412, "upload.version")
    assert other.headers["tus-version"] == "1.0.0"


def test_pieces_must_fit(client: TestClient) -> None:
    url = begin(client)
    assert send(client, url, 0, CLOUD[:1000]).headers["upload-offset"] == "1000"
    assert code(send(client, url, 0, CLOUD[:10])) == (409, "upload.offset")
    assert code(send(client, url, 1000, CLOUD)) == (413, "request.too_large")
    plain = client.patch(url, headers=TUS | {"Upload-Offset": "1000"}, content=b"x")
    assert code(plain) == (415, "request.media_type")
    assert code(client.post("/jobs", json={"upload": url})) == (409, "upload.incomplete")
    found = client.head(url, headers=TUS)
    assert (found.headers["upload-offset"], found.headers["upload-length"]) == (
        "1000",
        str(len(CLOUD)),
    )
    assert found.headers["cache-control"] == "no-store"

    def endless() -> Iterator[bytes]:
        for _ in range(40):
            yield CLOUD

    told = PIECE | {"Upload-Offset": "1000"}
    assert code(client.patch(url, headers=told, content=endless())) == (413, "request.too_large")
    at = int(client.head(url, headers=TUS).headers["upload-offset"])
    assert send(client, url, at, CLOUD[at:]).status_code == 204
    assert client.delete(url, headers=TUS).status_code == 204
    assert client.head(url, headers=TUS).status_code == 404


@pytest.mark.parametrize("algorithm", ["sha1", "sha256"])
def test_a_piece_with_a_checksum_counts_as_a_whole_or_not_at_all(
    client: TestClient, algorithm: str
) -> None:
    url = begin(client)
    digest = hashlib.new(algorithm, CLOUD[:5000]).digest()
    told = {"Upload-Checksum": f"{algorithm} {base64.b64encode(digest).decode()}"}
    assert code(send(client, url, 0, CLOUD[1:5001], **told)) == (460, "upload.checksum")
    assert client.head(url, headers=TUS).headers["upload-offset"] == "0"
    assert send(client, url, 0, CLOUD[:5000], **told).headers["upload-offset"] == "5000"
    for wrong in ("md4 AAAA", "sha1 ???"):
        refused = send(client, url, 5000, b"1", **{"Upload-Checksum": wrong})
        assert code(refused) == (422, "request.invalid")


def test_what_cannot_become_a_job_is_said_before_it_has_travelled(
    client: TestClient, quick: Settings
) -> None:
    huge = client.post("/uploads", headers=TUS | {"Upload-Length": "2000001"})
    assert code(huge) == (413, "request.too_large")
    for missing in ({}, {"Upload-Length": "-1"}, {"Upload-Length": "x"}):
        assert client.post("/uploads", headers=TUS | missing).status_code == 422
    bad = TUS | {"Upload-Length": "1", "Upload-Metadata": "filename @@"}
    assert code(client.post("/uploads", headers=bad)) == (422, "request.invalid")
    url = begin(client, 1_500_000)
    hopeless = send(client, url, 0, b"<html>" + bytes(300_000))
    assert code(hopeless)[0] == 422
    assert client.head(url, headers=TUS).status_code == 404
    full = quick.model_copy(update={"disk_low_fraction": 0.999})
    with TestClient(create_app(full), base_url="http://localhost") as other:
        refused = other.post("/uploads", headers=TUS | {"Upload-Length": "5"})
    assert code(refused) == (507, "storage.full")
    assert not list((quick.data_dir / "resumable").iterdir())


def test_a_repeated_submission_is_the_same_job_and_a_failed_one_keeps_the_upload(
    client: TestClient,
) -> None:
    url = begin(client)
    send(client, url, 0, CLOUD)
    bad = client.post("/jobs", json={"upload": url, "options": {"resolution": 1}})
    assert code(bad) == (422, "options.invalid")
    key = {"Idempotency-Key": "once"}
    first, again = (client.post("/jobs", headers=key, json={"upload": url}) for _ in range(2))
    assert (first.status_code, again.status_code) == (202, 202)
    assert first.json()["id"] == again.json()["id"]
    other = client.post("/jobs", headers=key, json={"upload": url, "label": "other"})
    assert code(other) == (409, "idempotency.conflict")
    assert code(client.post("/jobs", json={"upload": url})) == (404, "upload.not_found")
    for body in ({"upload": 1}, {"upload": url, "more": 1}, [1], {"upload": url, "label": 3}):
        assert code(client.post("/jobs", json=body)) == (422, "request.invalid")
    for sneaky in ("../../valkey", "/uploads/../x", "0" * 32):
        assert code(client.post("/jobs", json={"upload": sneaky})) == (404, "upload.not_found")


def test_uploads_belong_to_their_key_and_lapse(quick: Settings, redis: Redis) -> None:
    strict = quick.model_copy(update={"require_keys": True})
    with TestClient(create_app(strict), base_url="http://service.example") as client:
        anna, ben = (
            {"Authorization": f"Bearer {KeyStore(redis).create(name)[1]}"}
            for name in ("anna", "ben")
        )
        refused = client.post("/uploads", headers=TUS | {"Upload-Length": "9"})
        assert refused.status_code == 401
        url = begin(client, **anna)
        assert send(client, url, 0, CLOUD, **ben).status_code == 404
        assert client.head(url, headers=TUS | ben).status_code == 404
        assert client.delete(url, headers=TUS | ben).status_code == 404
        assert client.post("/jobs", headers=ben, json={"upload": url}).status_code == 404
        assert send(client, url, 0, CLOUD[:100], **anna).status_code == 204
        state = client.app.state.mpf  # type: ignore[attr-defined]
        kept = Retention(state.store, state.artifacts, strict)
        kept.round()
        assert client.head(url, headers=TUS | anna).status_code == 200
        later = time.time() + strict.resumable_seconds + 1
        Retention(state.store, state.artifacts, strict, wall=lambda: later).round()
        assert client.head(url, headers=TUS | anna).status_code == 404
