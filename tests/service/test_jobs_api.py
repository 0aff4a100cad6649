"""What a caller can do with jobs beside submitting and polling."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from redis import Redis
from starlette.testclient import TestClient

from service.app import create_app
from service.jobs.queue import JobQueue
from service.settings import Settings
from tests.services import form


@pytest.fixture
def client(settings: Settings) -> Iterator[TestClient]:
    quick = settings.model_copy(update={"content_check_bytes": 0})
    with TestClient(create_app(quick), base_url="http://localhost") as made:
        yield made


def test_the_same_request_with_the_same_key_is_the_same_job(
    client: TestClient, redis: Redis
) -> None:
    key = {"Idempotency-Key": "7b0c"}
    first = client.post("/jobs", headers=key, **form(seed=1))
    again = client.post("/jobs", headers=key, **form(seed=1))
    assert (first.status_code, again.status_code) == (202, 202)
    assert first.json() == again.json()
    assert first.headers["location"] == again.headers["location"]
    other = client.post("/jobs", headers=key, **form(seed=2))
    assert (other.status_code, other.json()["code"]) == (409, "idempotency.conflict")
    assert len(client.get("/jobs").json()["jobs"]) == 1
    assert len(JobQueue(redis, job_seconds=1).waiting()) == 1


def test_lists_are_paged_and_filtered(client: TestClient) -> None:
    ids = []
    for number in range(7):
        fields = form()
        fields["data"]["label"] = "odd" if number % 2 else "even"
        ids.append(client.post("/jobs", **fields).json()["id"])
    client.post(f"/jobs/{ids[0]}/cancel")
    seen, cursor = [], None
    while True:
        query = {"limit": 2} | ({"cursor": cursor} if cursor else {})
        page = client.get("/jobs", params=query).json()
        seen += [job["id"] for job in page["jobs"]]
        cursor = page["next"]
        if cursor is None:
            break
    assert seen == ids[::-1]
    odd = client.get("/jobs", params={"label": "odd", "limit": 200}).json()
    assert [job["id"] for job in odd["jobs"]] == ids[5::-2]
    assert odd["next"] is None
    ended = client.get("/jobs", params={"state": ["cancelled", "failed"]}).json()["jobs"]
    assert [job["id"] for job in ended] == ids[:1]
    assert client.get("/jobs", params={"cursor": "@@"}).json()["code"] == "request.invalid"


def test_delete_removes_everything(client: TestClient, settings: Settings, redis: Redis) -> None:
    job_id = client.post("/jobs", **form()).json()["id"]
    assert client.delete(f"/jobs/{job_id}").status_code == 204
    assert client.get(f"/jobs/{job_id}").json()["code"] == "job.not_found"
    assert client.delete(f"/jobs/{job_id}").status_code == 404
    assert not list((settings.data_dir / "jobs").iterdir())
    assert not redis.keys(f"*{job_id}*")
    assert client.get("/jobs").json() == {"jobs": [], "next": None}


def test_a_job_may_have_so_many_tiles(settings: Settings) -> None:
    few = settings.model_copy(update={"tiles_per_job": 1})
    with TestClient(create_app(few), base_url="http://localhost") as client:
        whole = client.post("/jobs", **form()).json()
        again = f"/jobs/{whole['id']}/retry"
        for answer in (
            client.post("/jobs", **form(tile_points=100)),
            client.post(again, json={"options": {"tile_points": 100}}),
        ):
            assert answer.status_code == 422, answer.text
            assert (answer.json()["code"], answer.json()["where"]) == (
                "options.invalid", "tile_points",
            )  # fmt: skip
        assert client.post("/jobs", **form(tile_points=100, tiles="off")).status_code == 202
        assert client.post("/jobs", **form(tile_points=200)).status_code == 202


def test_retry_uses_the_input_again_with_other_options(
    client: TestClient, settings: Settings
) -> None:
    first = client.post("/jobs", **form(preset="draft", seed=3)).json()
    answer = client.post(f"/jobs/{first['id']}/retry", json={"options": {"resolution": 64}})
    second = answer.json()
    assert answer.status_code == 202
    assert second["parent"] == first["id"]
    assert second["input"] == first["input"]
    assert second["options"] == first["options"] | {"resolution": 64}
    assert client.delete(f"/jobs/{first['id']}").status_code == 204
    assert (settings.data_dir / "jobs" / second["id"] / "input.xyz").stat().st_size > 0
    bad = client.post(f"/jobs/{second['id']}/retry", json={"options": {"resolution": 1}})
    assert bad.json()["code"] == "options.invalid"
    assert client.post(f"/jobs/{second['id']}/retry").status_code == 202
    key = {"Idempotency-Key": "again"}
    third, same = (client.post(f"/jobs/{second['id']}/retry", headers=key) for _ in range(2))
    assert third.json()["id"] == same.json()["id"]
    other = client.post(f"/jobs/{second['id']}/retry", headers=key, json={"label": "x"})
    assert (other.status_code, other.json()["code"]) == (409, "idempotency.conflict")
    assert len(list((settings.data_dir / "jobs").iterdir())) == 3
