"""Jobs on the field of another job: contract and life; the numerics are in tests/mpf_core."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from starlette.testclient import TestClient

from service.app import create_app
from service.settings import Settings
from tests.services import form, running_worker, wait_for


@pytest.fixture
def client(settings: Settings) -> Iterator[TestClient]:
    quick = settings.model_copy(update={"content_check_bytes": 0})
    with TestClient(create_app(quick), base_url="http://localhost") as made:
        yield made


def submit(client: TestClient, name: str, **options: Any) -> str:
    return str(client.post("/jobs", **form(name=name, **options)).json()["id"])


def ended(client: TestClient, job_id: str) -> dict[str, Any]:
    def look() -> dict[str, Any] | None:
        job: dict[str, Any] = client.get(f"/jobs/{job_id}").json()
        return job if job["state"] in ("succeeded", "failed") else None

    return wait_for(look, 30, job_id)


def extract(client: TestClient, job_id: str, **options: Any) -> Any:
    return client.post(f"/jobs/{job_id}/extractions", json={"options": options})


def problem(answer: Any) -> tuple[int, str]:
    return answer.status_code, answer.json()["code"]


def test_an_extraction_is_a_job_on_the_field_of_another(
    client: TestClient, settings: Settings
) -> None:
    fit = submit(client, "ok.xyz", resolution=64, slices=7, omega=20.0)
    assert problem(extract(client, fit)) == (409, "job.not_ready")
    with running_worker(settings):
        about = ended(client, fit)["artifacts"]["field.safetensors"]
        field = client.get(about["href"])
        assert field.content == b"field of " + fit.encode()
        assert field.headers["content-type"] == "application/octet-stream"
        cuts = [{"axis": "z", "field": "r", "at": [0.25]}]
        answer = extract(client, fit, cuts=cuts)
        assert answer.status_code == 202
        job = answer.json()
        assert answer.headers["location"] == f"/jobs/{job['id']}"
        assert (job["kind"], job["parent"], job["state"]) == ("extraction", fit, "queued")
        assert job["input"]["sha256"] == about["sha256"]
        assert job["input"]["name"] == "field.safetensors"
        assert job["options"]["resolution"] == 64  # what is not named stays
        assert job["options"]["slices"] == 0  # but for the stack, which is there already
        assert "omega" not in job["options"]
        assert ended(client, job["id"])["state"] == "succeeded"

        # It stands by itself: its files, its input, its own retries and extractions.
        assert client.delete(f"/jobs/{fit}").status_code == 204
        url = f"/jobs/{job['id']}"
        assert client.get(f"{url}/mesh.glb").content == b"glTF of an extraction"
        assert client.get(f"{url}/slices/r/z/0.png").headers["content-type"] == "image/png"
        assert problem(client.get(f"{url}/slices/P/z/0.png")) == (404, "artifact.not_found")
        assert problem(client.get(f"{url}/slices/psi/z/0.png")) == (422, "request.invalid")
        told = client.get(f"{url}/report.json").json()
        assert told["field"] == f"field of {fit}"
        again = client.post(f"{url}/retry", json={"options": {"resolution": 32}}).json()
        assert (again["kind"], again["parent"]) == ("extraction", job["id"])
        assert again["options"] == job["options"] | {"resolution": 32}
        key = {"Idempotency-Key": "third"}
        asked = {"options": {"resolution": 16}}
        third, same = (
            client.post(f"{url}/extractions", headers=key, json=asked).json() for _ in range(2)
        )
        assert third["id"] == same["id"]
        assert (third["parent"], third["input"]) == (job["id"], job["input"])
        for one in (again, third):
            assert ended(client, one["id"])["state"] == "succeeded"
        listed = [one["id"] for one in client.get("/jobs").json()["jobs"]]
        assert listed == [third["id"], again["id"], job["id"]]


def test_what_has_no_field_says_so(client: TestClient, settings: Settings) -> None:
    assert problem(extract(client, "0" * 32)) == (404, "job.not_found")
    with running_worker(settings):
        line, bare, gone = (
            submit(client, name) for name in ("line.xyz", "fieldless.xyz", "ok.xyz")
        )
        for job_id in (line, bare, gone):
            ended(client, job_id)
    assert problem(extract(client, line)) == (409, "job.no_result")
    assert problem(extract(client, bare)) == (404, "artifact.not_found")
    client.app.state.mpf.store.expire(gone, {"code": "job.expired"})  # type: ignore[attr-defined]
    assert problem(extract(client, gone)) == (410, "job.expired")
    assert problem(client.get(f"/jobs/{gone}/field.safetensors")) == (410, "job.expired")


@pytest.mark.parametrize(
    ("options", "where"),
    [
        ({"resolution": 3}, "resolution"),
        ({"omega": 30}, "omega"),
        ({"cuts": [{"axis": "w", "count": 1}]}, "cuts[0].axis"),
        ({"mesh": False}, "mesh"),
    ],
)
def test_bad_options_are_refused_before_a_job_is_made(
    client: TestClient, options: dict[str, Any], where: str
) -> None:
    parent = submit(client, "ok.xyz")
    answer = extract(client, parent, **options)
    assert problem(answer) == (422, "options.invalid")
    assert answer.json()["where"] == where
    assert len(client.get("/jobs").json()["jobs"]) == 1


def test_capabilities_tell_what_may_be_extracted(client: TestClient) -> None:
    told = client.get("/capabilities").json()["extraction"]["properties"]
    assert told["resolution"]["maximum"] == 2048
    assert told["cuts"]["items"]["properties"]["field"]["enum"] == ["phi", "r", "theta", "P"]
