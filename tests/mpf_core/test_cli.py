"""`mpf reconstruct` as a stranger meets it: files, exit codes, one sentence for every mistake."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import trimesh
from click.testing import CliRunner, Result

from mpf_core.cli import main
from mpf_core.errors import Cancelled, Diverged, NoSurface
from mpf_core.fit.sampler import warm_pools
from mpf_core.surface import export
from tests.mpf_core.clouds import sphere

SMALL = ["--preset", "draft", "--max-iterations", "30", "--resolution", "24", "--threads", "1"]
SMALL += ["--set", "width=16", "--set", "slices=1", "--set", "start_points=512"]


@pytest.fixture(autouse=True)
def _small_pools(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mpf_core.pipeline.warm_pools", partial(warm_pools, size=10_000))


@pytest.fixture
def cloud(tmp_path: Path) -> Path:
    path = tmp_path / "cloud.xyz"
    np.savetxt(path, sphere(200))
    return path


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, ["reconstruct", *map(str, arguments)])


def complaint(result: Result, code: int = 2) -> str:
    """The one line that a failed run leaves."""
    assert result.exit_code == code, result.output
    assert "Traceback" not in result.output
    lines = [line for line in result.stderr.splitlines() if line.startswith("mpf: ")]
    assert len(lines) == 1
    assert result.stdout == ""
    return lines[0]


@pytest.mark.parametrize("suffix", [".glb", ".ply", ".PLY"])
def test_a_cloud_becomes_a_mesh(cloud: Path, tmp_path: Path, suffix: str) -> None:
    out = tmp_path / f"out{suffix}"
    result = run(cloud, "-o", out, *SMALL)
    assert result.exit_code == 0, result.output
    mesh = trimesh.load(out, file_type=suffix[1:].lower(), force="mesh")
    assert len(mesh.faces) > 100
    assert str(out) in result.stdout
    assert f"{len(mesh.faces)} faces" in result.stdout
    assert len(result.stdout.splitlines()) == 1


def test_slices_and_report_go_where_asked(cloud: Path, tmp_path: Path) -> None:
    slices, report = tmp_path / "a" / "cuts", tmp_path / "report.json"
    out = tmp_path / "o.ply"
    result = run(cloud, "-o", out, *SMALL, "--seed", "5", "--slices", slices, "--report", report)
    assert result.exit_code == 0, result.output
    assert len(list(slices.rglob("*.png"))) == 3
    told = json.loads(report.read_text("utf-8"))
    assert told["seed"] == 5
    assert told["options"]["preset"] == "draft"
    assert told["options"]["width"] == 16
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a", "cloud.xyz", "o.ply", "report.json"]


def test_progress_is_plain_lines_when_not_on_a_terminal(cloud: Path, tmp_path: Path) -> None:
    result = run(cloud, "-o", tmp_path / "o.ply", *SMALL)
    assert "\r" not in result.stderr
    assert "\033" not in result.stderr
    words = result.stderr.split()
    places = [words.index(s) for s in ("read", "prepare", "initialize", "fit", "extract", "report")]
    assert places == sorted(places)


@pytest.mark.parametrize(
    ("content", "code"),
    [
        (b"", "input.empty"),
        (b"\x00\x01\x02\xff" * 50, None),
        (b"0 0 0\n1 1 1\n", "cloud.too_small"),
        (b"".join(b"%d %d %d\n" % (i, 2 * i, -i) for i in range(99)), "cloud.collinear"),
        (b"nan 0 0\n" * 99, "cloud.not_finite"),
        (b"1 2 3\n" * 99, "cloud.too_small"),
        (b"ply\nformat ascii 1.0\n", None),
    ],
    ids=["empty", "bytes", "few", "line", "nan", "repeated", "cut off"],
)
def test_bad_clouds_end_with_2(tmp_path: Path, content: bytes, code: str | None) -> None:
    bad, out = tmp_path / "bad.xyz", tmp_path / "o.glb"
    bad.write_bytes(content)
    said = complaint(run(bad, "-o", out, *SMALL))
    assert code is None or said.endswith(f"[{code}]")
    assert not out.exists()


def test_missing_files_and_folders_end_with_2(cloud: Path, tmp_path: Path) -> None:
    absent = tmp_path / "absent.ply"
    assert "absent.ply" in complaint(run(absent, "-o", tmp_path / "o.ply"))
    complaint(run(tmp_path, "-o", tmp_path / "o.ply"))
    assert "nowhere" in complaint(run(cloud, "-o", tmp_path / "nowhere" / "o.ply"))


@pytest.mark.parametrize("name", ["o.obj", "o", "o.ply.gz"])
def test_other_meshes_than_glb_and_ply_are_refused_before_any_work(
    cloud: Path, tmp_path: Path, name: str
) -> None:
    assert ".glb" in complaint(run(cloud, "-o", tmp_path / name))


@pytest.mark.parametrize(
    ("arguments", "where"),
    [
        (["--max-iterations", "0"], "max_iterations"),
        (["--resolution", "3"], "resolution"),
        (["--time-budget", "nan"], "time_budget"),
        (["--seed", "-1"], "seed"),
        (["--threads", "0"], "threads"),
        (["--set", "omega=fast"], "omega"),
        (["--set", "omgea=30"], "omgea"),
        (["--set", "omega"], "omega"),
        (["--set", "seed=" + "9" * 5000], "seed"),
        (["--set", "omega=1" + "0" * 400], "omega"),
        (["--set", "optimizer=sgd"], "optimizer"),
    ],
    ids=lambda value: value[-1][:16] if isinstance(value, list) else value,
)
def test_bad_options_end_with_2(
    cloud: Path, tmp_path: Path, arguments: list[str], where: str
) -> None:
    out = tmp_path / "o.ply"
    assert where in complaint(run(cloud, "-o", out, *arguments))
    assert not out.exists()


@pytest.mark.parametrize("arguments", [["--preset", "best"], ["--seed", "x"], ["--nothing"]])
def test_flags_that_are_not_there_end_with_2(cloud: Path, arguments: list[str]) -> None:
    result = run(cloud, "-o", "o.ply", *arguments)
    assert result.exit_code == 2
    assert "Traceback" not in result.output


@pytest.mark.parametrize(
    ("error", "code"), [(NoSurface("none"), 3), (Diverged("off"), 3), (Cancelled("stop"), 130)]
)
def test_the_exit_code_tells_whose_fault_it_is(
    cloud: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception, code: int
) -> None:
    def fail(*_: object) -> None:
        raise error

    monkeypatch.setattr("mpf_core.results.reconstruct_cloud", fail)
    complaint(run(cloud, "-o", tmp_path / "o.ply", *SMALL), code)


def test_a_full_disk_leaves_nothing_half_written(
    cloud: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device", str(tmp_path / "o.ply"))

    monkeypatch.setattr(export, "write_atomically", full)
    assert "No space left" in complaint(run(cloud, "-o", tmp_path / "o.ply", *SMALL))


def test_ctrl_c_ends_with_130_and_no_traceback(cloud: Path, tmp_path: Path) -> None:
    out = tmp_path / "o.ply"
    command = [sys.executable, "-m", "mpf_core", "reconstruct", str(cloud), "-o", str(out)]
    command += ["--set", "width=16", "--max-iterations", "200000", "--time-budget", "500"]
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    with subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
        # Whoever runs the tests in the background may have it ignored.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # noqa: PLW1509
    ) as running:
        assert running.stderr is not None
        begin, said = time.monotonic(), ""
        while "fit" not in said and time.monotonic() - begin < 120:
            said = running.stderr.readline()
        running.send_signal(signal.SIGINT)
        _, rest = running.communicate(timeout=60)
    assert running.returncode == 130
    assert "Traceback" not in rest
    assert "[cancelled]" in rest
    assert not out.exists()
