"""A job past its time, and a store without room: each ends as it should, and the worker goes on."""

from __future__ import annotations

import base64
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx2
import pytest

from service.settings import Settings
from service.uploads.tus import PIECE_TYPE
from tests.services import form, running_api, running_worker, sphere_xyz, wait_for

DISK_BYTES = 6 * 2**20


def submit(api: str, name: str, data: bytes | None = None) -> str:
    answer = httpx2.post(f"{api}/jobs", timeout=60, **form(data, name=name))
    assert answer.status_code == 202, answer.text
    return str(answer.json()["id"])


def ended(api: str, job_id: str, seconds: float) -> dict[str, Any]:
    def look() -> dict[str, Any] | None:
        job: dict[str, Any] = httpx2.get(f"{api}/jobs/{job_id}", timeout=60).json()
        return job if job["state"] in ("succeeded", "failed") else None

    return wait_for(look, seconds, "the job ended")


def test_a_job_past_its_time_fails_even_if_it_does_not_hear_its_alarm(settings: Settings) -> None:
    hasty = settings.model_copy(update={"job_seconds": 3.0, "content_check_bytes": 0})
    with running_api(hasty) as api, running_worker(hasty), running_worker(hasty):
        jobs = [submit(api, name) for name in ("long-60.xyz", "deaf.xyz")]
        for job_id in jobs:
            job = ended(api, job_id, 20)
            assert (job["state"], job["problem"]["code"]) == ("failed", "job.time_limit")
            assert job["attempt"] == 1
        assert ended(api, submit(api, "ok.xyz"), 20)["state"] == "succeeded"


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system with room for very little."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={DISK_BYTES}", "tmpfs", str(folder)]
    if subprocess.run(mount, capture_output=True).returncode != 0:
        pytest.skip("this user cannot mount a file system")
    yield folder
    subprocess.run(["umount", "--lazy", str(folder)], check=True)


def test_a_full_disk_refuses_uploads_and_results_and_harms_nothing_else(
    settings: Settings, small_disk: Path
) -> None:
    told = {"data_dir": small_disk / "data", "disk_low_fraction": 0.0, "content_check_bytes": 0}
    tight = settings.model_copy(update=told)
    cloud = sphere_xyz(40_000)  # a bit more than a megabyte
    with running_api(tight) as api, running_worker(tight):
        kept = submit(api, "ok.xyz", cloud)
        assert ended(api, kept, 20)["state"] == "succeeded"

        big = httpx2.post(f"{api}/jobs", timeout=60, **form(cloud * 8, name="big.xyz"))
        assert (big.status_code, big.json()["code"]) == (507, "storage.full")
        assert int(big.headers["retry-after"]) > 0
        assert not list((tight.data_dir / "uploads").iterdir())

        full = ended(api, submit(api, "fill.xyz"), 20)
        assert (full["state"], full["problem"]["code"]) == ("failed", "storage.full")
        left = [p.name for p in (tight.data_dir / "jobs" / full["id"]).iterdir()]
        assert sorted(left) == ["at-work", "input.xyz"]  # the first is the test's own

        _resumes_when_there_is_room(api, cloud * 3, tight.data_dir / "ballast")
        assert ended(api, submit(api, "ok.xyz"), 20)["state"] == "succeeded"
        mesh = httpx2.get(f"{api}/jobs/{kept}/mesh.glb", timeout=20)
        assert mesh.content.startswith(b"glTF")
        assert httpx2.get(f"{api}/readyz", timeout=20).json()["status"] == "ready"


def _resumes_when_there_is_room(api: str, data: bytes, ballast: Path) -> None:
    """An upload in pieces stops when the disk is full and goes on once it is not."""
    tus = {"Tus-Resumable": "1.0.0"}
    name = base64.b64encode(b"a.xyz").decode()
    told = tus | {"Upload-Length": str(len(data)), "Upload-Metadata": f"filename {name}"}
    made = httpx2.post(f"{api}/uploads", headers=told, timeout=20)
    assert made.status_code == 201, made.text
    url = api + made.headers["location"]
    piece = tus | {"Content-Type": PIECE_TYPE}
    _fill(ballast, 1_000_000)
    stopped = httpx2.patch(url, headers=piece | {"Upload-Offset": "0"}, content=data, timeout=60)
    assert (stopped.status_code, stopped.json()["code"]) == (507, "storage.full")
    at = int(httpx2.head(url, headers=tus, timeout=20).headers["upload-offset"])
    assert 0 < at < len(data)
    ballast.unlink()
    rest = httpx2.patch(
        url, headers=piece | {"Upload-Offset": str(at)}, content=data[at:], timeout=60
    )
    assert rest.status_code == 204, rest.text
    job = httpx2.post(f"{api}/jobs", json={"upload": made.headers["location"]}, timeout=60)
    assert job.status_code == 202, job.text
    assert httpx2.delete(f"{api}/jobs/{job.json()['id']}", timeout=20).status_code == 204


def _fill(ballast: Path, left: int) -> None:
    """Take all room but `left` bytes."""
    ballast.write_bytes(bytes(max(0, shutil.disk_usage(ballast.parent).free - left)))
