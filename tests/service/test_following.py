"""Long polls and server-sent events, over real replicas of the API."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator
from typing import Any

import httpx2
import pytest

from service.settings import Settings
from tests.services import form, running_api, running_worker


@pytest.fixture
def api(settings: Settings) -> Iterator[str]:
    with running_api(settings.model_copy(update={"content_check_bytes": 0})) as url:
        yield url


def submit(api: str, name: str) -> str:
    return str(httpx2.post(f"{api}/jobs", timeout=20, **form(name=name)).json()["id"])


def events_of(answer: Any) -> Iterator[tuple[str, str, Any]]:
    """(id, name, data) of each event, as they come."""
    fields: dict[str, str] = {}
    for line in answer.iter_lines():
        if line == "" and "event" in fields:
            yield fields["id"], fields["event"], json.loads(fields["data"])
        if line == "":
            fields = {}
        else:
            name, _, value = line.partition(": ")
            fields[name] = value


def test_a_long_poll_answers_when_the_state_changes(api: str, settings: Settings) -> None:
    job_id = submit(api, "ok.xyz")
    start = time.monotonic()
    answer = httpx2.get(f"{api}/jobs/{job_id}", params={"wait": 0.5}, timeout=20)
    assert answer.json()["state"] == "queued"
    assert 0.4 < time.monotonic() - start < 5
    found: list[str] = []

    def poll() -> None:
        found.append(httpx2.get(f"{api}/jobs/{job_id}?wait=30", timeout=40).json()["state"])

    waiting = threading.Thread(target=poll)
    waiting.start()
    httpx2.post(f"{api}/jobs/{job_id}/cancel", timeout=20)
    waiting.join(5)
    assert found == ["cancelled"]
    assert httpx2.get(f"{api}/jobs/{job_id}?wait=61", timeout=20).status_code == 422


def test_events_come_as_they_happen_and_resume_at_another_replica(
    api: str, settings: Settings
) -> None:
    with running_worker(settings), running_api(settings) as replica:
        job_id = submit(api, "long-2.xyz")
        seen: list[tuple[str, str, Any]] = []
        with httpx2.stream("GET", f"{api}/jobs/{job_id}/events", timeout=30) as answer:
            assert answer.headers["content-type"].startswith("text/event-stream")
            for event in events_of(answer):
                seen.append(event)
                if event[1] == "progress":
                    break
        resume = {"Last-Event-ID": seen[-1][0]}
        url = f"{replica}/jobs/{job_id}/events"
        with httpx2.stream("GET", url, headers=resume, timeout=30) as answer:
            seen += list(events_of(answer))
        names = [name for _, name, _ in seen]
        assert names[0] == "job"
        assert names.count("job") == 1
        assert names[-1] == "state"
        assert seen[-1][2]["state"] == "succeeded"
        ids = [tuple(map(int, event_id.split("-"))) for event_id, _, _ in seen]
        assert ids == sorted(set(ids))
        fractions = [data["fraction"] for _, name, data in seen if name == "progress"]
        assert len(fractions) > 5
        assert fractions == sorted(fractions)
        after = httpx2.get(f"{api}/jobs/{job_id}/events", timeout=20).text
        assert '"state":"succeeded"' in after
    bad = httpx2.get(f"{api}/jobs/{job_id}/events", headers={"Last-Event-ID": "x"}, timeout=20)
    assert bad.status_code == 422


def test_previews_are_announced_replaced_and_gone_when_the_job_has_ended(
    api: str, settings: Settings
) -> None:
    job_id = submit(api, "show-60.xyz")
    url = f"{api}/jobs/{job_id}/preview.glb"
    assert httpx2.get(url, timeout=20).json()["code"] == "job.not_ready"
    with running_worker(settings), httpx2.Client(timeout=30) as client:
        share = client.post(f"{api}/jobs/{job_id}/shares").json()["href"]
        meshes: dict[str, bytes] = {}
        told = []
        with client.stream("GET", f"{api}/jobs/{job_id}/events") as answer:
            for _, name, data in events_of(answer):
                if name != "preview":
                    continue
                told.append(data["number"])
                found = httpx2.get(f"{api}{data['href']}", timeout=20)
                if found.status_code == 200:
                    meshes[found.headers["etag"]] = found.content
                    shown = httpx2.get(f"{api}/jobs/{job_id}", timeout=20).json()
                    assert shown["state"] != "running" or shown["links"]["preview"]
                if len(meshes) == 3:
                    break
        shown = client.get(f"{api}{share}/preview.glb")
        assert shown.content.startswith(b"glTF")
        assert client.get(url, headers={"If-None-Match": "*no*"}).status_code == 200
        client.post(f"{api}/jobs/{job_id}/cancel")
        job = client.get(f"{api}/jobs/{job_id}?wait=30").json()
    assert told == sorted(set(told))
    assert len(set(meshes.values())) == 3
    assert all(mesh.startswith(b"glTF") for mesh in meshes.values())
    assert job["state"] == "cancelled"
    assert "preview" not in job["links"]
    assert "preview.glb" not in job["artifacts"]
    assert httpx2.get(url, timeout=20).json()["code"] == "artifact.not_found"
    assert not list((settings.data_dir / "jobs" / job_id).glob("preview*"))
