"""The shipped worker with the real pipeline, kept as small as it can be."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient

from service.app import create_app
from service.settings import Settings
from tests import gltf
from tests.services import form, running_worker, sphere_xyz, wait_for

pytestmark = pytest.mark.slow

SMALL: dict[str, Any] = {"preset": "draft", "resolution": 32, "slices": 1, "width": 32}
WORKER = "tests.worker.shipped"


@pytest.fixture
def client(settings: Settings) -> Iterator[TestClient]:
    with TestClient(create_app(settings), base_url="http://localhost") as made:
        yield made


def submit(client: TestClient, **options: Any) -> str:
    answer = client.post("/jobs", **form(sphere_xyz(600), **(SMALL | options)))
    assert answer.status_code == 202, answer.text
    return str(answer.json()["id"])


def until(client: TestClient, job_id: str, state: str) -> dict[str, Any]:
    def look() -> dict[str, Any] | None:
        job: dict[str, Any] = client.get(f"/jobs/{job_id}").json()
        assert job["state"] in (state, "queued", "running"), job["problem"]
        return job if job["state"] == state else None

    return wait_for(look, 60, state)


def test_a_cloud_becomes_a_mesh_and_a_cancelled_fit_can_keep_its_surface(
    client: TestClient, settings: Settings, tmp_path: Path
) -> None:
    with running_worker(settings, WORKER):
        whole = until(client, submit(client, max_iterations=30), "succeeded")
        names = set(whole["artifacts"])
        assert {"mesh.glb", "mesh.ply", "field.safetensors", "slices/x/0.png"} <= names
        glb = client.get(whole["artifacts"]["mesh.glb"]["href"])
        (tmp_path / "mesh.glb").write_bytes(glb.content)
        gltf.assert_valid(tmp_path / "mesh.glb")
        assert glb.headers["content-type"] == "model/gltf-binary"

        endless = submit(client, max_iterations=200_000, time_budget=600.0)
        wait_for(
            # Before 50 iterations there is no surface to keep.
            lambda: (
                ((client.get(f"/jobs/{endless}").json()["progress"] or {}).get("iteration") or 0)
                >= 60
            ),
            60,
            "the fit",
        )
        assert client.post(f"/jobs/{endless}/cancel?keep=result").json()["cancelling"] is True
        kept = until(client, endless, "succeeded")
        report = json.loads(client.get(kept["artifacts"]["report.json"]["href"]).text)
        assert report["fit"]["stopped_by"] == "cancel"
