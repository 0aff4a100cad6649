"""The shipped worker fits a cloud in tiles, with the real pipeline, kept as small as it can be."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from redis import Redis
from starlette.testclient import TestClient

from mpf_core.tiles.child import HURRIED
from service.app import create_app
from service.jobs.model import TILE
from service.jobs.tile_store import TileStore
from service.settings import Settings
from tests import gltf
from tests.services import form, running_worker, sphere_xyz, wait_for

pytestmark = pytest.mark.slow

SMALL: dict[str, Any] = {
    "preset": "draft", "resolution": 32, "slices": 1, "width": 32, "max_iterations": 200_000,
    "time_budget": 600.0, "tile_points": 1000,
}  # fmt: skip


@pytest.fixture
def client(settings: Settings) -> Iterator[TestClient]:
    with TestClient(create_app(settings), base_url="http://localhost") as made:
        yield made


def ended(client: TestClient, job_id: str) -> dict[str, Any]:
    def look() -> dict[str, Any] | None:
        job: dict[str, Any] = client.get(f"/jobs/{job_id}").json()
        return job if job["state"] in ("succeeded", "failed", "cancelled") else None

    return wait_for(look, 90, job_id)


def test_a_cloud_in_tiles_becomes_one_surface_as_soon_as_that_is_asked_for(
    client: TestClient, settings: Settings, redis: Redis
) -> None:
    """One tile is fitted until its owner has seen enough, the other one in short."""
    store = TileStore(redis, retention_seconds=100.0)
    answer = client.post("/jobs", **form(sphere_xyz(2000), **SMALL))
    assert answer.status_code == 202, answer.text
    job_id = answer.json()["id"]

    def seen_enough() -> bool:
        progress = [tile.progress for tile in store.running() if tile.kind == TILE]
        return any(told is not None and (told.iteration or 0) > 60 for told in progress)

    with running_worker(settings, "tests.worker.shipped"):
        wait_for(seen_enough, 60, "a tile's fit")
        client.post(f"/jobs/{job_id}/cancel?keep=result")
        job = ended(client, job_id)
        assert job["state"] == "succeeded", job["problem"]
        again = client.post(f"/jobs/{job_id}/extractions", json={"options": {"resolution": 24}})
        extracted = ended(client, again.json()["id"])
    assert job["tiles"] == {"done": 2, "running": 0, "total": 2}
    assert {"mesh.glb", "mesh.ply", "field.safetensors", "slices/x/0.png"} <= set(job["artifacts"])
    report = client.get(f"/jobs/{job_id}/report.json").json()
    ends = [(tile["stopped_by"], tile["iterations"]) for tile in report["tiles"]["each"]]
    assert ends[0][0] == "cancel"
    assert ends[1] == ("iterations", HURRIED)
    assert report["surface"]["components"] == 1
    glb = settings.data_dir / "jobs" / job_id / f"result-{job['attempt']}" / "mesh.glb"
    gltf.assert_valid(glb)
    # The blended field serves as the field of one fit does.
    assert extracted["state"] == "succeeded", extracted["problem"]
    assert "mesh.glb" in extracted["artifacts"]
