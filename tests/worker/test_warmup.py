"""A worker compiles the loops of a fit into the data folder before a job asks for them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from service.settings import Settings
from worker.warmup import cache_of_loops, warming


@pytest.fixture(autouse=True)
def nowhere_else(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)


def test_loops_stand_in_the_data_folder_unless_another_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = Settings(data_dir=tmp_path)
    assert cache_of_loops(settings) == {"NUMBA_CACHE_DIR": str(tmp_path / "loops")}
    monkeypatch.setenv("NUMBA_CACHE_DIR", "/elsewhere")
    assert cache_of_loops(settings) == {}


def test_the_process_ends_with_the_worker(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[subprocess.Popen[bytes]] = []
    popen = subprocess.Popen

    def noted(*args: object, **kwargs: object) -> subprocess.Popen[bytes]:
        started.append(popen(*args, **kwargs))  # type: ignore[call-overload]
        return started[-1]

    monkeypatch.setattr(subprocess, "Popen", noted)
    with warming(Settings(data_dir=tmp_path)):
        assert started[0].poll() is None
    assert started[0].returncode is not None


@pytest.mark.slow
def test_a_warm_worker_leaves_nothing_to_compile(tmp_path: Path) -> None:
    environment = os.environ | cache_of_loops(Settings(data_dir=tmp_path))
    environment["MPF_PARENT_PID"] = str(os.getpid())
    command = [sys.executable, "-m", "worker.warmup"]
    subprocess.run(command, env=environment, check=True, start_new_session=True)
    kept = {path: path.stat().st_mtime_ns for path in (tmp_path / "loops").rglob("*.nb*")}
    assert len(kept) > 30
    fit = (
        "from mpf_core.compiled import prepare_loops; "
        "from mpf_core.field.precision import products_in; "
        "assert prepare_loops(products_in('auto')).NAME == 'fused'"
    )
    subprocess.run([sys.executable, "-c", fit], env=environment, check=True)
    assert {p: p.stat().st_mtime_ns for p in (tmp_path / "loops").rglob("*.nb*")} == kept
