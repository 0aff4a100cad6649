"""The Python client and its commands against a real service, over a line that loses things."""

from __future__ import annotations

import asyncio
import hashlib
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx2
import pytest
from click.testing import CliRunner

from service.client import AsyncClient, Client, Job, Refused, Unreachable, acts
from service.client.cli import cancel, jobs, submit
from service.settings import Settings
from tests.services import running_api, running_worker, sphere_xyz


@pytest.fixture
def api(settings: Settings) -> Iterator[str]:
    quick = settings.model_copy(update={"content_check_bytes": 0})
    with running_api(quick) as url:
        yield url


@pytest.fixture
def cloud(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Some 140 kB, sent in pieces of 20 kB."""
    monkeypatch.setattr(acts, "PIECE_BYTES", 20_000)
    path = tmp_path / "ok.xyz"
    path.write_bytes(sphere_xyz(5000))
    return path


class Lossy(httpx2.HTTPTransport):
    """Every third request never arrives, every fifth answer is lost, every seventh is a 503."""

    def __init__(self) -> None:
        super().__init__()
        self.count = 0

    def handle_request(self, request: httpx2.Request) -> httpx2.Response:
        self.count += 1
        if self.count % 3 == 0:
            raise httpx2.ConnectError("never arrived")
        if self.count % 7 == 0:
            return httpx2.Response(503, headers={"Retry-After": "0"}, request=request)
        answer = super().handle_request(request)
        if self.count % 5 == 0:
            answer.read()
            raise httpx2.ReadError("the answer is lost")
        return answer


def test_a_job_over_a_line_that_loses_things(
    settings: Settings, api: str, cloud: Path, tmp_path: Path
) -> None:
    moved: list[tuple[int, int]] = []
    looked: list[Job] = []
    with running_worker(settings), Client(api) as service:
        service._http = httpx2.Client(transport=Lossy(), follow_redirects=True)
        job = service.submit(
            cloud, {"preset": "draft"}, label="lossy", moved=lambda *at: moved.append(at)
        )
        assert job.input is not None
        assert job.input.sha256 == hashlib.sha256(cloud.read_bytes()).hexdigest()
        assert (job.label, job.options["preset"]) == ("lossy", "draft")
        assert moved[0][0] == 0
        assert moved[-1] == (job.input.bytes, job.input.bytes)
        ended = service.wait(job.id, looked.append)
        assert ended.state == "succeeded"
        assert looked[-1] == ended
        service.download(ended, "mesh.glb", tmp_path / "mesh.glb")
        found = hashlib.sha256((tmp_path / "mesh.glb").read_bytes()).hexdigest()
        assert found == ended.artifacts["mesh.glb"].sha256
        assert [one.id for one in service.jobs(label="lossy")] == [job.id], "sent twice, one job"
        child = service.wait(service.extract(job.id, {"resolution": 64}).id)
        assert (child.parent, child.state) == (job.id, "succeeded")
        again = service.retry(job.id)
        assert service.wait(again.id).state == "succeeded"
        with pytest.raises(KeyError):
            service.download(ended, "nothing.glb", tmp_path / "x")


def test_an_upload_goes_on_where_it_was(api: str, cloud: Path) -> None:
    began: list[str] = []

    class CutOff(Exception):
        pass

    def cut(done: int, _size: int) -> None:
        if done >= 40_000:
            raise CutOff

    with Client(api) as service:
        with pytest.raises(CutOff):
            service.submit(cloud, moved=cut, began=began.append)
        moved: list[int] = []
        job = service.submit(cloud, upload=began[0], moved=lambda done, _: moved.append(done))
    assert moved[0] == 40_000
    assert job.input is not None
    assert job.input.sha256 == hashlib.sha256(cloud.read_bytes()).hexdigest()


def test_problems_and_silence_are_told_apart(api: str, tmp_path: Path) -> None:
    (tmp_path / "bad.ply").write_bytes(b"ply\nformat ascii 1.0\nelement vertex x\n" + bytes(70_000))
    with Client(api) as service:
        with pytest.raises(Refused) as refused:
            service.job("0" * 32)
        assert (refused.value.code, refused.value.problem.status) == ("job.not_found", 404)
        with pytest.raises(Refused) as refused:
            service.submit(tmp_path / "bad.ply")
        assert refused.value.code.startswith("ply.")
    silent = Client("http://127.0.0.1:9", patience=0.5)
    with silent, pytest.raises(Unreachable, match="does not answer"):
        silent.jobs()


def test_bytes_that_are_others_are_not_taken(settings: Settings, api: str, cloud: Path) -> None:
    with running_worker(settings), Client(api) as service:
        job = service.wait(service.submit(cloud).id)
        about = job.artifacts["mesh.glb"].model_copy(update={"sha256": "0" * 64})
        other = job.model_copy(update={"artifacts": {"mesh.glb": about}})
        with pytest.raises(Unreachable, match="other bytes"):
            service.download(other, "mesh.glb", cloud.parent / "mesh.glb")
    assert not (cloud.parent / "mesh.glb").exists()
    assert not list(cloud.parent.glob("*.part"))


def test_the_same_without_blocking(settings: Settings, api: str, cloud: Path) -> None:
    async def several() -> list[Job]:
        async with AsyncClient(api) as service:
            sent = await asyncio.gather(*(service.submit(cloud, label=f"{n}") for n in range(3)))
            ended = await asyncio.gather(*(service.wait(job.id) for job in sent))
            await service.download(ended[0], "mesh.ply", cloud.parent / "mesh.ply")
            await service.delete(ended[1].id)
            assert len(await service.jobs(limit=2)) == 2
            return list(ended)

    with running_worker(settings):
        ended = asyncio.run(several())
    assert {job.state for job in ended} == {"succeeded"}
    assert (cloud.parent / "mesh.ply").read_bytes().startswith(b"ply\n")


def test_the_commands(settings: Settings, api: str, cloud: Path, tmp_path: Path) -> None:
    here = ["--server", api]
    mesh, report = tmp_path / "mesh.glb", tmp_path / "report.json"
    with running_worker(settings):
        done = run(submit, str(cloud), *here, "--preset", "draft", "--set", "seed=3", "--wait",
                   "-o", str(mesh), "--report", str(report), "--label", "mine")  # fmt: skip
        assert done.exit_code == 0, done.output
        assert mesh.read_bytes().startswith(b"glTF")
        assert json.loads(report.read_text())["attempt"] == 1
        job_id = done.stdout.split()[0]
    listed = run(jobs, *here, "--label", "mine", "--json")
    told = json.loads(listed.stdout)
    assert (told["id"], told["options"]["seed"]) == (job_id, 3)
    waiting = run(submit, str(cloud), *here).stdout.strip()
    stopped = run(cancel, waiting, *here)
    assert stopped.exit_code == 0
    assert "cancelled" in stopped.stdout
    assert waiting in run(jobs, *here, "--state", "cancelled").stdout
    missing = run(cancel, "0" * 32, *here)
    assert (missing.exit_code, "job.not_found" in missing.output) == (4, True)
    wrong = run(submit, str(cloud), *here, "--set", "omega=-1")
    assert (wrong.exit_code, "omega" in wrong.output) == (4, True)
    nothing = run(submit, str(tmp_path / "none.ply"), *here)
    assert nothing.exit_code == 2


def run(command: Any, *arguments: str) -> Any:
    return CliRunner().invoke(command, list(arguments))


def test_a_client_never_loads_torch() -> None:
    code = "import sys, service.client, service.client.cli; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
