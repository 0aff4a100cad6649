"""POST /inspect: the reader's findings or its problem, and nothing left behind."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from starlette.testclient import TestClient

from mpf_core.cloud.errors import error_codes
from mpf_core.cloud.inspection import inspect_cloud
from service.app import create_app
from service.openapi import document
from service.settings import Settings
from tests.services import sphere_xyz


@pytest.fixture
def client(settings: Settings) -> Iterator[TestClient]:
    quick = settings.model_copy(update={"content_check_bytes": 0, "upload_bytes": 2_000_000})
    with TestClient(create_app(quick), base_url="http://localhost") as made:
        yield made
    assert not list((settings.data_dir / "uploads").iterdir())
    assert not list((settings.data_dir / "jobs").iterdir())


def test_the_answer_is_that_of_the_command(client: TestClient, tmp_path: Path) -> None:
    data = b"x,y,z\n" + sphere_xyz(300).replace(b" ", b",")
    path = tmp_path / "scan.csv"
    path.write_bytes(data)
    expected = json.loads(json.dumps(inspect_cloud(path).as_dict()))
    assert expected["preparation"]["density"]["spacing"] > 0
    form = client.post("/inspect", files={"file": ("a/b\\scan.csv", data)})
    assert (form.status_code, form.json()) == (200, expected)
    bare = client.post(
        "/inspect?name=scan.csv",
        content=data,
        headers={"content-type": "application/octet-stream"},
    )
    assert (bare.status_code, bare.json()) == (200, expected)
    assert client.get("/jobs").json()["jobs"] == []


def test_points_without_a_surface_are_still_described(client: TestClient) -> None:
    answer = client.post("/inspect", files={"file": ("a.xyz", sphere_xyz(20))})
    assert answer.status_code == 200
    assert answer.json()["preparation"] is None
    assert "cloud.too_small" in answer.json()["warnings"][-1]


@pytest.mark.parametrize(
    ("data", "status", "code", "where"),
    [
        (b"", 422, "input.empty", None),
        (b"1 2 3\n4 5 6\n7 8\n", 422, "xyz.row.columns", "line 3"),
        (b"ply\nformat ascii 1.0\n", 422, "ply.header.truncated", None),
        (bytes(3_000_000), 413, "request.too_large", "file"),
    ],
)
def test_problems_carry_the_codes_of_the_reader(
    client: TestClient, data: bytes, status: int, code: str, where: str | None
) -> None:
    answer = client.post("/inspect", files={"file": ("a.bin", data)})
    problem = answer.json()
    assert (answer.status_code, problem["code"]) == (status, code)
    assert where is None or problem["where"] == where
    assert problem["advice"]


def test_forms_without_a_file(client: TestClient) -> None:
    answer = client.post("/inspect", data={"label": "a"}, files={"cloud": b"x"})
    assert (answer.status_code, answer.json()["code"]) == (422, "request.invalid")
    assert client.post("/inspect", json={}).json()["code"] == "request.media_type"


def test_an_inspection_that_takes_too_long_is_ended(settings: Settings) -> None:
    hasty = settings.model_copy(update={"inspect_seconds": 0.01})
    with TestClient(create_app(hasty), base_url="http://localhost") as client:
        answer = client.post("/inspect", files={"file": ("a.xyz", sphere_xyz())})
    assert (answer.status_code, answer.json()["code"]) == (422, "input.not_inspected")
    assert not list((settings.data_dir / "uploads").iterdir())


def test_the_closed_list_of_codes_is_published(client: TestClient) -> None:
    codes = set(error_codes())
    assert codes <= set(client.get("/capabilities").json()["problems"])
    described = json.loads(document())["components"]["schemas"]["Problem"]["properties"]["code"]
    assert codes <= set(described["enum"])
    assert len(described["enum"]) == len(described["x-enum-descriptions"])
