"""Fetching results, and what the service tells about itself."""

from __future__ import annotations

import hashlib
import io
import zipfile
from collections.abc import Iterator

import pytest
from starlette.testclient import TestClient

from service.app import create_app
from service.connection import connect
from service.operations.store import FitRate
from service.settings import Settings
from tests.services import running_worker, sphere_xyz, wait_for


@pytest.fixture
def client(settings: Settings) -> Iterator[TestClient]:
    with TestClient(create_app(settings), base_url="http://localhost") as made:
        yield made


def test_a_bare_body_becomes_files_with_tags_ranges_and_an_archive(
    client: TestClient, settings: Settings
) -> None:
    query = {"name": "ok.xyz", "options": '{"seed": 5}', "label": "bare"}
    raw = {"Content-Type": "application/octet-stream"}
    job = client.post("/jobs", params=query, headers=raw, content=sphere_xyz()).json()
    assert (job["options"]["seed"], job["label"], job["input"]["points"]) == (5, "bare", 200)
    url = f"/jobs/{job['id']}"
    assert client.get(f"{url}/result.zip").json()["code"] == "job.not_ready"
    with running_worker(settings):
        wait_for(lambda: client.get(url).json()["state"] == "succeeded", 30, "success")
    whole = client.get(f"{url}/mesh.glb")
    sha256 = hashlib.sha256(whole.content).hexdigest()
    about = client.get(url).json()["artifacts"]["mesh.glb"]
    assert (about["sha256"], about["bytes"]) == (sha256, len(whole.content))
    assert whole.headers["etag"] == f'"{sha256}"'
    assert "mesh.glb" in whole.headers["content-disposition"]
    known = client.get(f"{url}/mesh.glb", headers={"If-None-Match": whole.headers["etag"]})
    assert (known.status_code, known.content) == (304, b"")
    part = client.get(f"{url}/mesh.glb", headers={"Range": "bytes=4-9"})
    assert (part.status_code, part.content) == (206, whole.content[4:10])
    beyond = client.get(f"{url}/mesh.glb", headers={"Range": "bytes=99999-"})
    assert (beyond.status_code, beyond.json()["code"]) == (416, "request.range")
    assert beyond.headers["content-range"].endswith(str(len(whole.content)))
    archive = zipfile.ZipFile(io.BytesIO(client.get(f"{url}/result.zip").content))
    assert archive.testzip() is None
    assert archive.read("mesh.glb") == whole.content
    assert "slices/y/0.png" in archive.namelist()
    figures = client.get("/metrics").text
    assert 'mpf_jobs{state="succeeded"} 1' in figures
    assert 'mpf_jobs_ended_total{state="succeeded",code=""} 1' in figures
    assert "mpf_queue_oldest_seconds 0" in figures


def test_the_input_comes_back_to_its_owner_byte_by_byte(client: TestClient) -> None:
    cloud = sphere_xyz()
    raw = {"Content-Type": "application/octet-stream"}
    job = client.post("/jobs", params={"name": "ok.xyz"}, headers=raw, content=cloud).json()
    whole = client.get(job["links"]["input"])
    assert (whole.status_code, whole.content) == (200, cloud)
    # A browser must not make a page of it, whatever is in it.
    assert whole.headers["content-disposition"].startswith("attachment")
    assert whole.headers["content-type"] == "application/octet-stream"
    assert whole.headers["x-content-type-options"] == "nosniff"
    known = client.get(job["links"]["input"], headers={"If-None-Match": whole.headers["etag"]})
    assert known.status_code == 304
    part = client.get(job["links"]["input"], headers={"Range": "bytes=3-7"})
    assert (part.status_code, part.content) == (206, cloud[3:8])
    link = client.post(f"/jobs/{job['id']}/shares").json()["href"]
    assert client.get(f"{link}/input").status_code in (404, 409)
    client.delete(f"/jobs/{job['id']}")
    assert client.get(job["links"]["input"]).json()["code"] == "job.not_found"


def test_the_rate_of_fits_is_told_once_there_was_one(
    client: TestClient, settings: Settings
) -> None:
    assert client.get("/capabilities").json()["rate"] == {"points_per_second": None}
    redis = connect(settings)
    FitRate(redis).note(1000.0)
    FitRate(redis).note(3000.0)
    redis.close()
    assert client.get("/capabilities").json()["rate"] == {"points_per_second": 2000.0}


def test_capabilities_tell_limits_before_an_upload(client: TestClient) -> None:
    told = client.get("/capabilities").json()
    assert told["limits"]["points_least"] == 51
    assert set(told["presets"]) == {"draft", "balanced", "paper"}
    assert told["options"]["properties"]["seed"]["type"] == "integer"
    assert told["problems"]["job.expired"]["status"] == 410
