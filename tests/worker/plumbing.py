"""A worker whose jobs do what their input's name says: everything is real but the fit.

ok        write a result
fieldless write one without a field
long-30   work for up to 30 s, then write a result
show-30   the same, with previews
line      raise Collinear
die-2     kill the own process in attempts 1 to 2
stubborn  do not listen to cancel
hungry    allocate without end
deaf      work for 60 s without hearing alarms, as native code may
fill      write a result of 50 MB

tiled-4-WORD is split into 4 tiles:
tiled-4-ok, -split30, -tile30, -join30   work for up to 30 s in that part; -each30: in each of them
tiled-4-line, -die                       in the second tile do as above, in all attempts
"""

from __future__ import annotations

import fcntl
import json
import os
import signal
import sys
import time
from pathlib import Path
from typing import IO

from mpf_core.errors import Cancelled, Collinear
from mpf_core.progress import Progress
from service.jobs.model import TILE, Job
from service.settings import Settings
from worker import job_process, runners
from worker.main import run_worker
from worker.rq_worker import MpfWorker

SAMPLES = 150
"""Of each tile."""


class PlumbingWorker(MpfWorker):
    job_module = "tests.worker.plumbing_job"


def word_of(run: runners.Run) -> str:
    assert run.job.input is not None
    return Path(run.job.input.name).stem.partition("-")[0]


def runner(run: runners.Run) -> None:
    assert run.job.input is not None
    word, _, number = Path(run.job.input.name).stem.partition("-")
    alone = _alone(run)
    if word == "line":
        raise Collinear("the points lie on a line")
    if word == "die" and run.job.attempt <= int(number):
        os.kill(os.getpid(), signal.SIGKILL)
    if word == "hungry":
        _eat()
    if word == "deaf":
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGALRM})
        time.sleep(60)
    if word == "fill":
        (run.out / "mesh.glb").write_bytes(bytes(50_000_000))
    if word in ("long", "show", "stubborn", "burn"):
        _work(run, float(number or 60), heed=word != "stubborn", pause=0.02 * (word != "burn"))
    _write(run.out, run.job.attempt)
    if alone is not None:
        alone.close()
    if word != "fieldless":
        (run.out / "field.safetensors").write_bytes(b"field of " + run.job.id.encode())


def is_large(job: Job, given: Path) -> bool:
    return job.input is not None and job.input.name.startswith("tiled")


def split_runner(run: runners.Run) -> None:
    assert run.job.input is not None
    _, number, task = Path(run.job.input.name).stem.split("-")
    _part(run, "split", task)
    tiles = []
    for index in range(int(number)):
        told, name = {"index": index, "task": task}, f"tile-{index:03}.safetensors"
        (run.out / name).write_text(json.dumps(told))
        tiles.append({"file": name, "samples": SAMPLES})
    (run.out / "plan.json").write_text(json.dumps({"task": task, "tiles": tiles}))


def tile_runner(run: runners.Run) -> None:
    told = json.loads(run.input.read_text())
    _part(run, "tile", told["task"])
    if told["index"] == 1 and told["task"] == "line":
        raise Collinear("the points lie on a line")
    if told["index"] == 1 and told["task"] == "die":
        os.kill(os.getpid(), signal.SIGKILL)
    kept = ", kept" * run.reporter.stop()
    (run.out / "field.safetensors").write_text(f"tile {told['index']}{kept}")


def join_runner(run: runners.Run) -> None:
    """Shows what it was given."""
    assert run.gathered is not None
    plan = json.loads((run.gathered.plan / "plan.json").read_text())
    alone = _alone(run)
    _part(run, "join", plan["task"])
    fields = [(folder / "field.safetensors").read_text() for folder in run.gathered.fitted]
    (run.out / "mesh.glb").write_bytes(b"glTF" + bytes(1000))
    (run.out / "field.safetensors").write_text(" | ".join(fields))
    report = {"attempt": run.job.attempt, "fields": fields, "input": run.input.name}
    (run.out / "report.json").write_text(json.dumps(report))
    if alone is not None:
        alone.close()


def _part(run: runners.Run, part: str, task: str) -> None:
    if task.startswith((part, "each")):
        seconds = float(task.removeprefix(part).removeprefix("each"))
        _work(run, seconds, heed=True, pause=0.02)


def _alone(run: runners.Run) -> IO[bytes] | None:
    """Leaves a file `two-at-once` beside the input if another process is at work on this job."""
    lock = run.input.with_name("at-work").open("ab")
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        run.input.with_name("two-at-once").touch()
        return None
    return lock


def extraction_runner(run: runners.Run) -> None:
    """Shows which field it was given and what was asked of it."""
    told = {"field": run.input.read_text(), "options": dict(run.job.options)}
    (run.out / "report.json").write_text(json.dumps(told))
    (run.out / "mesh.glb").write_bytes(b"glTF of an extraction")
    folder = run.out / "slices" / "r" / "z"
    folder.mkdir(parents=True)
    (folder / "0.png").write_bytes(b"\x89PNG\r\n\x1a\n")


def _work(run: runners.Run, seconds: float, *, heed: bool, pause: float) -> None:
    start = time.monotonic()
    while (passed := time.monotonic() - start) < seconds:
        run.reporter.progress(
            Progress("fit", passed / seconds, passed, iteration=int(passed * 100), loss=1.0)
        )
        if word_of(run) == "show":
            run.preview(b"glTF" + int(passed * 10).to_bytes(4, "big"))
        if heed and run.reporter.cancel():
            raise Cancelled("stopped")
        if run.job.kind == TILE and run.reporter.stop():
            return
        time.sleep(pause)


def _eat() -> None:
    kept = []
    while True:
        kept.append(bytearray(32 * 2**20))


def _write(out: Path, attempt: int) -> None:
    (out / "mesh.glb").write_bytes(b"glTF" + bytes(1000))
    (out / "mesh.ply").write_bytes(b"ply\n" + bytes(1000))
    (out / "report.json").write_text(f'{{"attempt": {attempt}}}')
    for axis in "xyz":
        folder = out / "slices" / axis
        folder.mkdir(parents=True)
        (folder / "0.png").write_bytes(b"\x89PNG\r\n\x1a\n")


def main_of_job() -> None:
    runners.RUNNERS |= {
        "fit": runner, "extraction": extraction_runner,
        "split": split_runner, "tile": tile_runner, "join": join_runner,
    }  # fmt: skip
    runners.is_large = is_large
    job_process.main()


if __name__ == "__main__":
    run_worker(Settings(), PlumbingWorker)
    assert "torch" not in sys.modules
