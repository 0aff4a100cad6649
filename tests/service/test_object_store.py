"""Inputs, results, previews and checkpoints in an object store: two implementations of S3, one of
Azure's."""

from __future__ import annotations

import hashlib
import io
import os
import time
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx2
import pytest
from starlette.testclient import TestClient

from service.app import create_app
from service.artifacts.base import Artifacts, NoSuchStore, Published, StoreUnavailable
from service.artifacts.bucket import Bucket, bucket_at
from service.artifacts.object_store import ObjectArtifacts
from service.artifacts.opened import artifacts_of
from service.artifacts.store import ArtifactStore
from service.jobs.model import new_job_id
from service.operations.retention import Retention
from service.settings import Settings
from tests.objects import Place
from tests.services import form, running_worker, sphere_xyz, wait_for

TUS = {"Tus-Resumable": "1.0.0"}
PIECE = TUS | {"Content-Type": "application/offset+octet-stream"}


@pytest.fixture
def client(place: Place) -> Iterator[TestClient]:
    """An API over the store; links are looked at, not followed."""
    quick = place.settings.model_copy(update={"content_check_bytes": 0})
    app = create_app(quick)
    with TestClient(app, base_url="http://localhost", follow_redirects=False) as client:
        yield client


def submitted(client: TestClient, name: str = "ok.xyz") -> str:
    answer = client.post("/jobs", **form(name=name))
    assert answer.status_code == 202, answer.text
    return str(answer.json()["id"])


def ended(client: TestClient, job_id: str) -> dict[str, Any]:
    def look() -> dict[str, Any] | None:
        job: dict[str, Any] = client.get(f"/jobs/{job_id}").json()
        return job if job["state"] in ("succeeded", "failed", "cancelled") else None

    return wait_for(look, 20, "the job's end")


def test_from_the_upload_to_the_files_and_their_removal(place: Place, client: TestClient) -> None:
    with running_worker(place.settings):
        job_id = submitted(client)
        assert "input.xyz" in place.of(job_id)
        job = ended(client, job_id)
        assert job["state"] == "succeeded", job
        assert "result-1.json" in place.of(job_id)
        files_are_served(client, job)
        the_input_is_served(client, job)
        again = client.post(f"/jobs/{job_id}/retry").json()["id"]
        taken = client.post(f"/jobs/{job_id}/extractions").json()["id"]
        for child, suffix in ((again, "xyz"), (taken, "safetensors")):
            the_input_is_served(client, client.get(f"/jobs/{child}").json(), suffix)
        assert ended(client, again)["state"] == "succeeded"
        told = ended(client, taken)
        report = client.get(f"/jobs/{taken}/report.json", headers={"Sec-Fetch-Dest": "empty"})
        assert report.json()["field"] == f"field of {job_id}", told
    assert client.delete(f"/jobs/{job_id}").status_code == 204
    assert place.of(job_id) == set()
    assert "input.xyz" in place.of(again)
    work = place.settings.data_dir / "work"
    assert not list(work.iterdir()), "nothing stays on the worker's machine"
    assert not list((place.settings.data_dir / "uploads").iterdir())


def files_are_served(client: TestClient, job: dict[str, Any]) -> None:
    href, about = job["artifacts"]["mesh.glb"]["href"], job["artifacts"]["mesh.glb"]
    sent = client.get(href)
    assert sent.status_code == 307
    tag = f'"{about["sha256"]}"'
    assert (sent.headers["etag"], sent.headers["cache-control"]) == (tag, "no-store")
    # Whoever has the link needs no key, neither ours nor the store's.
    there = httpx2.get(sent.headers["location"])
    assert hashlib.sha256(there.content).hexdigest() == about["sha256"]
    assert there.headers["content-type"] == "model/gltf-binary"
    assert f'{job["id"][:8]}-mesh.glb"' in there.headers["content-disposition"]
    part = httpx2.get(sent.headers["location"], headers={"Range": "bytes=2-5"})
    assert part.content == there.content[2:6]
    script = {"Sec-Fetch-Dest": "empty"}
    whole = client.get(href, headers=script)
    assert (whole.status_code, whole.content) == (200, there.content)
    assert whole.headers["etag"] == tag
    assert whole.headers["repr-digest"].startswith("sha-256=:")
    for asked, expected in (
        ("bytes=2-5", there.content[2:6]),
        ("bytes=-7", there.content[-7:]),
        ("bytes=1000-", there.content[1000:]),
    ):
        piece = client.get(href, headers=script | {"Range": asked})
        assert (piece.status_code, piece.content) == (206, expected), asked
        assert piece.headers["content-range"].endswith(f"/{len(whole.content)}")
    beyond = client.get(href, headers=script | {"Range": "bytes=99999-"})
    assert (beyond.status_code, beyond.json()["code"]) == (416, "request.range")
    stale = client.get(href, headers=script | {"Range": "bytes=0-1", "If-Range": '"other"'})
    assert stale.status_code == 200
    known = client.get(href, headers={"If-None-Match": tag})
    assert known.status_code == 304
    archive = client.get(f"/jobs/{job['id']}/result.zip")
    with zipfile.ZipFile(io.BytesIO(archive.content)) as packed:
        assert set(packed.namelist()) == set(job["artifacts"])
        assert packed.read("mesh.glb") == there.content


def the_input_is_served(client: TestClient, job: dict[str, Any], suffix: str = "xyz") -> None:
    href, sha256 = job["links"]["input"], job["input"]["sha256"]
    sent = client.get(href)
    assert (sent.status_code, sent.headers["etag"]) == (307, f'"{sha256}"')
    there = httpx2.get(sent.headers["location"])
    assert hashlib.sha256(there.content).hexdigest() == sha256
    # Wherever it comes from, a browser must not make a page of it.
    assert there.headers["content-type"] == "application/octet-stream"
    assert there.headers["content-disposition"].startswith("attachment")
    assert there.headers["content-disposition"].endswith(f'.{suffix}"')
    for asked in ({"Sec-Fetch-Dest": "empty"}, {"Prefer": "return=representation"}):
        whole = client.get(href, headers=asked)
        assert (whole.status_code, whole.content) == (200, there.content)
        name = f'attachment; filename="{job["id"][:8]}-input.{suffix}"'
        assert whole.headers["content-disposition"] == name
        assert whole.headers["x-content-type-options"] == "nosniff"
        assert "immutable" in whole.headers["cache-control"]
        part = client.get(href, headers=asked | {"Range": "bytes=3-7"})
        assert (part.status_code, part.content) == (206, there.content[3:8])
    assert client.get(href, headers={"If-None-Match": f'"{sha256}"'}).status_code == 304


def test_a_cloud_in_tiles_leaves_one_result(place: Place, client: TestClient) -> None:
    with running_worker(place.settings):
        job_id = submitted(client, "tiled-2-ok.xyz")
        job = ended(client, job_id)
        assert job["state"] == "succeeded", job["problem"]
        report = client.get(f"/jobs/{job_id}/report.json", headers={"Sec-Fetch-Dest": "empty"})
        assert report.json()["fields"] == ["tile 0", "tile 1"]
        wait_for(
            lambda: not any(name.startswith("result-1") for name in place.of(job_id)),
            10,
            "plan and tiles are gone",
        )
    assert {"input.xyz", "result-2.json", "result-2/report.json"} <= place.of(job_id)
    assert list(artifacts_of(place.settings).job_ids()) == [job_id]
    assert not list((place.settings.data_dir / "work").iterdir())


def test_a_result_is_read_where_another_attempt_works(place: Place, tmp_path: Path) -> None:
    bucket = bucket_at(place.settings)
    stores: list[Artifacts] = [on_machine(bucket, tmp_path / "a"), ArtifactStore(tmp_path / "b")]
    for artifacts in stores:
        artifacts.prepare()
        (tmp_path / "cloud").write_bytes(b"0 0 0")
        job_id = new_job_id()
        artifacts.adopt_input(job_id, tmp_path / "cloud", "xyz")
        for attempt in (1, 12):
            folder = artifacts.work(job_id, attempt)
            (folder / "plan.json").write_bytes(b"plan %d" % attempt)
            (folder / "tile-000").write_bytes(b"tile")
            artifacts.publish(job_id, attempt)
        for but, left in ((None, {"plan.json", "tile-000"}), ("tile-", {"plan.json"})):
            found = artifacts.local_result(
                Published(job_id, 1), job_id, 13 + (but is None), but=but
            )
            assert (found / "plan.json").read_bytes() == b"plan 1"
            assert left <= {path.name for path in found.iterdir()}
        with pytest.raises(FileNotFoundError):
            artifacts.local_result(Published(job_id, 2), job_id, 13)
        artifacts.forget_results(job_id, but=1)
        assert artifacts.result(job_id, 1, "plan.json").size == 6
        with pytest.raises(FileNotFoundError):
            artifacts.local_result(Published(job_id, 12), job_id, 15)
        for attempt in (13, 14, 15):
            artifacts.discard_work(job_id, attempt)


def test_previews_are_shown_and_go(place: Place, client: TestClient) -> None:
    with running_worker(place.settings):
        job_id = submitted(client, "show-20.xyz")
        wait_for(
            lambda: client.get(f"/jobs/{job_id}/preview.glb").status_code == 200, 20, "a preview"
        )
        client.post(f"/jobs/{job_id}/cancel")
        assert ended(client, job_id)["state"] == "cancelled"
        wait_for(lambda: place.of(job_id) == {"input.xyz"}, 10, "the preview is removed")


def test_pieces_arrive_over_any_replica(place: Place) -> None:
    data = sphere_xyz(5000)
    third = len(data) // 3
    digest = hashlib.sha256(data[third : 2 * third])
    checksum = {"Upload-Checksum": f"sha256 {_base64(digest.digest())}"}
    with two_replicas(place.settings) as (one, two):
        about = TUS | {"Upload-Length": str(len(data)), "Upload-Metadata": "filename cy54eXo="}
        url = one.post("/uploads", headers=about).headers["location"]
        assert send(two, url, 0, data[:third]).headers["upload-offset"] == str(third)
        assert send(two, url, 0, data[:third]).json()["code"] == "upload.offset"
        spoiled = send(one, url, third, data[: third - 1], checksum)
        assert spoiled.json()["code"] == "upload.checksum"
        sent = send(one, url, third, data[third : 2 * third], checksum)
        assert sent.headers["upload-offset"] == str(2 * third)
        early = one.post("/jobs", json={"upload": url}).json()
        assert early["code"] == "upload.incomplete"
        # While one replica takes a piece the other refuses another.
        state = one.app.state.mpf  # type: ignore[attr-defined]
        writer = state.resumable.begin(state.resumable.get("", url[9:]), 2 * third, None)
        assert send(two, url, 2 * third, b"x").status_code == 423
        writer.write(data[2 * third : 2 * third + 5])
        writer.close()  # a lost connection: what has come counts
        assert two.head(url, headers=TUS).headers["upload-offset"] == str(2 * third + 5)
        send(two, url, 2 * third + 5, data[2 * third + 5 :])
        job = one.post("/jobs", json={"upload": url}).json()
        assert job["input"]["sha256"] == hashlib.sha256(data).hexdigest()
        assert two.head(url, headers=TUS).status_code == 404
    assert not [key for key in place.objects() if key.startswith("resumable/")]


def test_a_writer_that_lost_its_lock_changes_nothing(place: Place) -> None:
    with two_replicas(place.settings) as (one, two):
        about = TUS | {"Upload-Length": "30"}
        url = one.post("/uploads", headers=about).headers["location"]
        state = one.app.state.mpf  # type: ignore[attr-defined]
        late = state.resumable.begin(state.resumable.get("", url[9:]), 0, None)
        late.write(b"1 2 3\n")
        state.redis.delete(f"mpf:upload:{url[9:]}:lock")  # as if its time were over
        assert send(two, url, 0, b"4 5 6\n7 8 9\n").status_code == 204
        with pytest.raises(Exception, match="another request"):
            late.finish()
        late.close()
        assert two.head(url, headers=TUS).headers["upload-offset"] == "12"
        upload = state.resumable.get("", url[9:])
        (part,) = state.resumable._parts(upload)
        assert b"".join(state.resumable._bucket.read(part.key, 0, part.size)) == b"4 5 6\n7 8 9\n"


def test_a_result_is_there_with_its_list_and_never_before(place: Place, tmp_path: Path) -> None:
    bucket = bucket_at(place.settings)
    one, two = (on_machine(bucket, tmp_path / name) for name in "ab")
    job_id = new_job_id()
    for store, attempt in ((one, 1), (two, 2)):
        folder = store.work(job_id, attempt)
        (folder / "slices").mkdir()
        (folder / "mesh.glb").write_bytes(b"of %d" % attempt)
        (folder / "slices" / "0.png").write_bytes(b"slice")
    found = two.publish(job_id, 2)
    assert set(found) == {"mesh.glb", "slices/0.png"}
    assert b"".join(one.result(job_id, 2, "mesh.glb").read()) == b"of 2"
    # The attempt before has lost its lease, and was cut off while it published.
    bucket.put(f"jobs/{job_id}/result-1/mesh.glb", b"of 1")
    with pytest.raises(FileNotFoundError):
        two.result(job_id, 1, "mesh.glb")
    assert b"".join(one.result(job_id, 2, "mesh.glb").read()) == b"of 2"
    with pytest.raises(FileNotFoundError):
        one.result(job_id, 2, "../result-1/mesh.glb")


def test_checkpoints_go_from_machine_to_machine(place: Place, tmp_path: Path) -> None:
    bucket = bucket_at(place.settings)
    one, two = (on_machine(bucket, tmp_path / name) for name in "ab")
    job_id = new_job_id()
    with one.checkpoint(job_id, 1) as path:
        assert not path.exists()
        path.write_bytes(b"after 15 s")
        wait_for(lambda: "checkpoint-1" in place.of(job_id), 10, "kept while it runs")
        path.write_bytes(b"handed back")
    with two.checkpoint(job_id, 2) as path:
        assert path.read_bytes() == b"handed back"
        path.write_bytes(b"of the second")
    # One that lost its lease and does not know it yet spoils nothing.
    with one.checkpoint(job_id, 1) as path:
        path.write_bytes(b"late")
    with two.checkpoint(job_id, 3) as path:
        assert path.read_bytes() == b"of the second"
    with one.checkpoint(job_id, 4, inherit=False) as path:
        assert not path.exists()
    two.forget_checkpoints(job_id)
    assert place.of(job_id) == set()


def test_files_of_nobody_are_removed_by_one_of_all(place: Place, client: TestClient) -> None:
    state = client.app.state.mpf  # type: ignore[attr-defined]
    waiting = submitted(client)
    bucket = bucket_at(place.settings)
    orphan, upload = new_job_id(), "0" * 32
    bucket.put(f"jobs/{orphan}/input.xyz", b"x")
    bucket.put(f"resumable/{upload}/about.json", b"{}")
    work = place.settings.data_dir / "work"
    dead, alive = work / f"{orphan}-1", work / f"{waiting}-1"
    state.artifacts.work(waiting, 1)
    dead.mkdir()
    later = time.time() + 2 * place.settings.resumable_seconds
    for folder in (dead, alive):
        os.utime(folder, (1, 1))
    rounds = [
        Retention(state.store, state.artifacts, place.settings, wall=lambda: later)
        for _ in range(2)
    ]
    rounds[0].round()
    assert place.of(orphan) == set()
    assert not [key for key in place.objects() if key.startswith("resumable/")]
    assert "input.xyz" in place.of(waiting)
    assert (dead.exists(), alive.exists()) == (False, True)
    bucket.put(f"jobs/{orphan}/input.xyz", b"x")
    rounds[1].round()
    assert place.of(orphan), "listing a store costs: one worker does it, now and then"
    state.artifacts.discard_work(waiting, 1)


@pytest.mark.slow
@pytest.mark.parametrize("place", ["rclone"], indirect=True)  # moto forgets when it ends
def test_a_store_that_is_away_is_waited_for(place: Place, client: TestClient) -> None:
    with running_worker(place.settings):
        job_id = submitted(client, "long-2.xyz")
        wait_for(lambda: client.get(f"/jobs/{job_id}").json()["state"] == "running", 20, "a start")
        place.store.stop()
        assert client.get("/readyz").json()["storage"] is False
        refused = client.post("/jobs", **form())
        assert (refused.status_code, refused.json()["code"]) == (503, "service.unavailable")
        time.sleep(4)  # the job has ended meanwhile, and has nowhere to leave its result
        assert client.get(f"/jobs/{job_id}").json()["state"] == "running"
        place.store.start()
        job = ended(client, job_id)
        assert (job["state"], job["attempt"]) == ("succeeded", 1)
    assert client.get("/readyz").json()["storage"] is True


def test_a_url_names_a_folder_or_a_store(settings: Settings, tmp_path: Path) -> None:
    given = settings.model_copy(update={"store_url": f"file://{tmp_path}/elsewhere"})
    store = artifacts_of(given)
    assert isinstance(store, ArtifactStore)
    assert store.root == tmp_path / "elsewhere"
    for url in ("nonsense", "ftp://host/x"):
        with pytest.raises(NoSuchStore, match="MPF_STORE_URL"):
            artifacts_of(settings.model_copy(update={"store_url": url}))


def test_without_links_the_api_passes_all_on(place: Place, tmp_path: Path) -> None:
    bucket = bucket_at(place.settings.model_copy(update={"store_link_seconds": 0.0}))
    store = on_machine(bucket, tmp_path)
    job_id = new_job_id()
    (store.work(job_id, 1) / "mesh.glb").write_bytes(b"mesh")
    store.publish(job_id, 1)
    assert store.result(job_id, 1, "mesh.glb").link() is None
    public = place.settings.model_copy(update={"store_link_endpoint": "https://files.example"})
    link = bucket_at(public).link(f"jobs/{job_id}/result-1/mesh.glb", 60)
    assert link is not None
    assert link.startswith("https://files.example/")


def test_an_error_says_what_and_never_the_secret(
    place: Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in place.store.away().items():
        monkeypatch.setenv(name, value)
    with pytest.raises(StoreUnavailable) as told:
        bucket_at(place.settings).get("x")
    assert "get x" in str(told.value)
    assert place.store.secret not in str(told.value)


class two_replicas:  # noqa: N801  reads as a statement
    """Two APIs over the same store and Redis."""

    def __init__(self, settings: Settings):
        quick = settings.model_copy(update={"content_check_bytes": 0})
        self._clients = [
            TestClient(create_app(quick), base_url="http://localhost") for _ in range(2)
        ]

    def __enter__(self) -> list[TestClient]:
        for client in self._clients:
            client.__enter__()
        return self._clients

    def __exit__(self, *error: Any) -> None:
        for client in self._clients:
            client.__exit__(*error)


def send(
    client: TestClient, url: str, offset: int, data: bytes, more: dict[str, str] | None = None
) -> Any:
    headers = PIECE | {"Upload-Offset": str(offset)} | (more or {})
    return client.patch(url, headers=headers, content=data)


def on_machine(bucket: Bucket, folder: Path) -> ObjectArtifacts:
    store = ObjectArtifacts(bucket, folder)
    store.prepare()
    return store


def _base64(data: bytes) -> str:
    from base64 import b64encode

    return b64encode(data).decode()
