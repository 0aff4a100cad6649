"""Every error is an RFC 9457 problem with a stable code."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from starlette.testclient import TestClient

from service.app import create_app
from service.problems import MEDIA_TYPE, catalogue
from service.settings import Settings
from tests.services import Server, form, settings_for, sphere_xyz


@pytest.fixture
def client(settings: Settings) -> Iterator[TestClient]:
    with TestClient(
        create_app(settings), raise_server_exceptions=False, base_url="http://localhost"
    ) as made:
        yield made


def problem(answer: Any, status: int, code: str) -> dict[str, Any]:
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == MEDIA_TYPE
    body: dict[str, Any] = answer.json()
    assert (body["code"], body["status"]) == (code, status)
    assert code in catalogue()
    return body


def text(points: Any) -> bytes:
    return "\n".join(" ".join(str(v) for v in row) for row in points).encode()


LINE = text([(i, 2 * i, 0) for i in range(100)])
NAN = text([(float("nan"), 0, 0)] * 30) + b"\n" + sphere_xyz(100)
REPEATED = text(np.tile(np.random.default_rng(0).random((50, 3)), (4, 1)))
HUGE = (
    b"ply\nformat binary_little_endian 1.0\nelement vertex 20000000\n"
    b"property float x\nproperty float y\nproperty float z\nend_header\n" + bytes(200_000)
)


@pytest.mark.parametrize(
    ("data", "status", "code"),
    [
        (b"", 422, "input.empty"),
        (b"\x89PNG\r\n\x1a\n" + bytes(100), 422, None),
        (b"<html></html>", 422, "input.format_unknown"),
        (NAN, 422, "cloud.not_finite"),
        (sphere_xyz(50), 422, "cloud.too_small"),
        (REPEATED, 422, "cloud.too_small"),
        (LINE, 422, "cloud.collinear"),
        (HUGE, 413, "cloud.too_large"),
    ],
    ids=["empty", "png", "html", "nan", "fifty", "fifty distinct", "line", "20 million"],
)
def test_bad_input_is_refused_at_the_door(
    client: TestClient, settings: Settings, data: bytes, status: int, code: str | None
) -> None:
    answer = client.post("/jobs", **form(data))
    problem(answer, status, code or answer.json()["code"])
    assert answer.json()["advice"]
    assert not list((settings.data_dir / "uploads").iterdir())
    assert not list((settings.data_dir / "jobs").iterdir())


@pytest.mark.parametrize(
    ("options", "where"),
    [
        ('{"resolution": 1}', "resolution"),
        ('{"nonsense": 1}', "nonsense"),
        ('{"preset": "best"}', "preset"),
        ("[1]", "options"),
        ("{", "options"),
    ],
)
def test_bad_options(client: TestClient, options: str, where: str) -> None:
    answer = client.post(
        "/jobs", files={"file": ("a.xyz", sphere_xyz())}, data={"options": options}
    )
    assert problem(answer, 422, "options.invalid")["where"] == where


def test_bad_forms(client: TestClient) -> None:
    problem(client.post("/jobs", json={}), 422, "request.invalid")
    xml = {"content-type": "text/xml"}
    problem(client.post("/jobs", content=b"", headers=xml), 415, "request.media_type")
    problem(client.post("/jobs", files={"cloud": b"x"}), 422, "request.invalid")
    broken = {"content-type": "multipart/form-data; boundary=b"}
    problem(client.post("/jobs", content=b"--b\r\nno", headers=broken), 400, "request.malformed")
    problem(client.post("/jobs", content=b"", headers=broken), 400, "request.malformed")


def test_what_is_not_there(client: TestClient) -> None:
    problem(client.get("/nowhere"), 404, "not_found")
    problem(client.get("/jobs/" + "0" * 32), 404, "job.not_found")
    problem(client.get("/jobs/..%2f..%2fetc/mesh.glb"), 404, "not_found")
    problem(client.get("/jobs/x/slices/w/0.png"), 422, "request.invalid")
    answer = client.put("/jobs")
    problem(answer, 405, "method_not_allowed")
    assert answer.headers["allow"] == "GET, POST"


def test_bodies_have_a_limit(shared_server: Server, tmp_path: Path) -> None:
    small = settings_for(shared_server, tmp_path, upload_bytes=200_000, body_bytes=1000)
    with TestClient(create_app(small), base_url="http://localhost") as client:
        problem(client.post("/jobs", **form(bytes(900_000))), 413, "request.too_large")

        def endless() -> Iterator[bytes]:
            head = b'--b\r\nContent-Disposition: form-data; name="file"; filename="a.xyz"\r\n\r\n'
            yield head
            for _ in range(100):
                yield sphere_xyz(1000)

        headers = {"content-type": "multipart/form-data; boundary=b"}
        problem(client.post("/jobs", content=endless(), headers=headers), 413, "request.too_large")
        missing = "/jobs/" + "0" * 32 + "/cancel"
        problem(client.post(missing, content=bytes(2000)), 413, "request.too_large")
        problem(client.post(missing, content=bytes(900)), 404, "job.not_found")
        assert not list((small.data_dir / "uploads").iterdir())


def test_a_full_queue_and_an_absent_redis(shared_server: Server, tmp_path: Path) -> None:
    full = settings_for(shared_server, tmp_path, queue_length=1)
    with TestClient(create_app(full), base_url="http://localhost") as client:
        client.app.state.mpf.redis.flushall()  # type: ignore[attr-defined]
        assert client.post("/jobs", **form()).status_code == 202
        answer = client.post("/jobs", **form())
        problem(answer, 503, "queue.full")
        assert int(answer.headers["retry-after"]) > 0
    away = Settings(redis_url="redis://127.0.0.1:1/0", data_dir=tmp_path / "away")
    with TestClient(create_app(away), base_url="http://localhost") as client:
        problem(client.post("/jobs", **form()), 503, "service.unavailable")
        problem(client.get("/jobs/" + "0" * 32), 503, "service.unavailable")
        ready = client.get("/readyz")
        assert (ready.status_code, ready.json()["status"]) == (503, "unavailable")
        assert client.get("/livez").json() == {"status": "live"}


def test_an_accepted_job_says_where_it_is(client: TestClient) -> None:
    answer = client.post("/jobs", **form(preset="draft", seed=7))
    assert answer.status_code == 202
    job = answer.json()
    assert answer.headers["location"] == f"/jobs/{job['id']}"
    assert int(answer.headers["retry-after"]) > 0
    assert job["state"] == "queued"
    assert job["queue_position"] == 0
    assert (job["options"]["preset"], job["options"]["seed"]) == ("draft", 7)
    assert job["input"]["points"] == 200
    assert len(job["input"]["sha256"]) == 64
    assert client.get(answer.headers["location"]).json() == json.loads(answer.text)
    assert client.get("/readyz").json()["status"] == "degraded"
