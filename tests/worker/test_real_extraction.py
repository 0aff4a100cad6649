"""The shipped worker extracts from a field that a fit has left: no fit is run for it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import torch
from redis import Redis
from starlette.testclient import TestClient

from mpf_core.cloud.normalize import Similarity
from mpf_core.field import MetricPhaseField
from mpf_core.field.artefact import save_field
from mpf_core.field.fitted import FittedField
from mpf_core.field.footprint import Footprint
from service.app import create_app
from service.artifacts.store import ArtifactStore
from service.jobs.lease import Lease
from service.jobs.queue import JobQueue
from service.jobs.store import JobStore
from service.settings import Settings
from tests.mpf_core.clouds import sphere
from tests.services import form, running_worker, wait_for

pytestmark = pytest.mark.slow


@pytest.fixture
def client(settings: Settings) -> Iterator[TestClient]:
    quick = settings.model_copy(update={"content_check_bytes": 0})
    with TestClient(create_app(quick), base_url="http://localhost") as made:
        yield made


def field() -> FittedField:
    """θ = 2 sin(sin(sin(z / 2))): the plane z = 0."""
    made = MetricPhaseField(width=8, omega=1.0, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        for weights in made.siren.parameters():
            weights.zero_()
        made.siren.input_weight[0, 2] = 0.5
        made.siren.shared_weight[0, 0] = made.siren.phase_weight[0, 0] = 1.0
        made.siren.phase_output[0] = 2.0
    footprint = Footprint.of(sphere(60), spacing=0.3, reach=0.3, thickness=None)
    box = np.array([[-1.0, -1, -1], [1, 1, 1]])
    return FittedField(made, Similarity(np.zeros(3), 1.0), box, footprint)


def fitted(client: TestClient, settings: Settings, redis: Redis) -> str:
    """A job that ends as if a worker had fitted the field."""
    job_id = str(client.post("/jobs", **form(slices=1)).json()["id"])
    store = JobStore(redis, retention_seconds=settings.retention_seconds)
    artifacts = ArtifactStore(settings.data_dir)
    lease = Lease(job_id, 1, "test")
    JobQueue(redis, job_seconds=60).withdraw(job_id, 1)
    store.start(lease)
    save_field(field(), artifacts.work(job_id, 1) / "field.safetensors")
    store.succeed(lease, artifacts.publish(job_id, 1))
    return job_id


def ended(client: TestClient, job_id: str) -> dict[str, Any]:
    def look() -> dict[str, Any] | None:
        job: dict[str, Any] = client.get(f"/jobs/{job_id}").json()
        return job if job["state"] in ("succeeded", "failed") else None

    return wait_for(look, 60, job_id)


def test_a_field_becomes_a_mesh_and_slices(
    client: TestClient, settings: Settings, redis: Redis
) -> None:
    url = f"/jobs/{fitted(client, settings, redis)}/extractions"
    asked = {"resolution": 24, "cuts": [{"axis": "z", "field": "theta", "at": [0.1]}]}
    outside = {"mesh": False, "cuts": [{"axis": "z", "at": [77.0]}]}
    ids = [client.post(url, json={"options": options}).json()["id"] for options in (asked, outside)]
    with running_worker(settings, "tests.worker.shipped"):
        job, lost = (ended(client, job_id) for job_id in ids)
    assert job["state"] == "succeeded", job["problem"]
    assert set(job["artifacts"]) == {"mesh.glb", "mesh.ply", "report.json", "slices/theta/z/0.png"}
    report = client.get(f"/jobs/{job['id']}/report.json").json()
    assert report["extraction"]["resolution"] == 24
    assert report["surface"]["components"] == 1
    assert report["slices"][0]["at"] == pytest.approx(0.1)
    picture = client.get(f"/jobs/{job['id']}/slices/theta/z/0.png")
    assert picture.content.startswith(b"\x89PNG")
    assert lost["problem"]["code"] == "options.outside_box"
    assert "from -1 to 1" in lost["problem"]["advice"]
