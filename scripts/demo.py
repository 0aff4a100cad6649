"""The demo: start the service, send it a cloud, follow the job, fetch the result, draw a picture.

Everything a client does here is plain HTTP; docs/http.md tells the rest of the contract.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any
from urllib.error import HTTPError, URLError
from urllib.parse import quote, urlencode
from urllib.request import Request, urlopen

import click

from mpf_core.options import PRESET_NAMES

Job = dict[str, Any]

START_SECONDS = 90.0
"""How long the service may take to start."""

STOP_SECONDS = 45.0
"""How long it may take to end; its parts have limits of their own below this."""

POLL_SECONDS = 0.5
PLAIN_SECONDS = 5.0
"""Between two lines of progress where there is no terminal."""

SERVING = "serving on "
"""The service's log tells its address after these words."""


class DemoFailed(Exception):
    """str() says what went wrong, and what to do about it."""


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.argument(
    "file", required=False, type=click.Path(path_type=Path, exists=True, dir_okay=False)
)
@click.option("--sample", help="A sample by name instead of FILE; `mpf sample --list` tells them.")
@click.option(
    "--preset",
    type=click.Choice(PRESET_NAMES),
    default="balanced",
    show_default=True,
    help="draft takes about a minute on two cores, balanced about three, paper days.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("out"),
    show_default=True,
    help="Folder for the result.",
)
def main(file: Path | None, sample: str | None, preset: str, out: Path) -> None:
    """Turn the point cloud FILE (or a sample) into a surface, by way of the HTTP service."""
    if file is not None and sample is not None:
        raise click.UsageError("Give FILE or --sample, not both.")
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, _leave)
    begin = time.monotonic()
    out.mkdir(parents=True, exist_ok=True)
    _remove_old(out)
    try:
        cloud = file or _make_sample(sample, out)
        with (
            tempfile.TemporaryDirectory(prefix="mpf-demo-") as data_dir,
            service(data_dir, out / "service.log") as url,
        ):
            job = follow(url, submit(url, cloud, preset))
            fetch(url, job, out)
        _say("drawing the points and the surface side by side")
        draw(cloud, out / "mesh.ply", out / "picture.png")
    except DemoFailed as error:
        raise click.ClickException(str(error)) from error
    _tell(out, time.monotonic() - begin)


@contextmanager
def service(data_dir: str, log: Path) -> Iterator[str]:
    """`mpf serve` on a free port of this machine; its address. It ends with the block."""
    _say(f"starting the service: Valkey, API and one worker (log: {log})")
    own = {name: value for name, value in os.environ.items() if not name.startswith("MPF_")}
    own["MPF_LOG_FORMAT"] = "text"
    command = [sys.executable, "-m", "mpf_core", "serve", "--port", "0", "--data-dir", data_dir]
    with log.open("wb") as sink:
        # In a session of its own: Ctrl-C comes to us, and we end it in good order.
        process = subprocess.Popen(  # noqa: S603
            command, stdout=sink, stderr=subprocess.STDOUT, env=own, start_new_session=True
        )
    try:
        yield _address(process, log)
    finally:
        _say("stopping the service")
        _stop(process)


def _address(process: subprocess.Popen[bytes], log: Path) -> str:
    """Wait for the service to say where it is."""
    deadline = time.monotonic() + START_SECONDS
    while time.monotonic() < deadline:
        for line in log.read_text(errors="replace").splitlines():
            _, found, address = line.partition(SERVING)
            if found:
                return address.strip()
        if process.poll() is not None:
            raise DemoFailed(f"the service ended with {process.returncode}; see {log}")
        time.sleep(0.1)
    raise DemoFailed(f"the service did not start within {START_SECONDS:.0f} s; see {log}")


def _stop(process: subprocess.Popen[bytes]) -> None:
    """Ask the service to end, and wait; further signals no longer hurry us."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    process.terminate()
    try:
        process.wait(STOP_SECONDS)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def submit(url: str, cloud: Path, preset: str) -> Job:
    """POST /jobs with the cloud as the body; the queued job."""
    _say(f"POST /jobs with {cloud} ({cloud.stat().st_size / 1e6:.1f} MB), preset {preset}")
    query = urlencode({"name": cloud.name, "options": json.dumps({"preset": preset})})
    headers = {"Content-Type": "application/octet-stream"}
    job: Job = json.loads(_answer(Request(f"{url}/jobs?{query}", cloud.read_bytes(), headers)))  # noqa: S310
    return job


def follow(url: str, job: Job) -> Job:
    """GET /jobs/{id} until the job has ended; the succeeded job."""
    _say(f"GET {job['links']['self']} until it has ended")
    line = ProgressLine()
    try:
        while job["state"] in ("queued", "running"):
            line.show(job)
            time.sleep(POLL_SECONDS)
            job = json.loads(_answer(f"{url}{job['links']['self']}"))
    except (KeyboardInterrupt, SystemExit):
        line.end()
        cancel(url, job)
        raise
    line.end()
    if job["state"] != "succeeded":
        problem = job["problem"] or {}
        advice = problem.get("advice") or ""
        raise DemoFailed(f"the job {job['state']}: {problem.get('detail', '')} {advice}".strip())
    return job


def cancel(url: str, job: Job) -> None:
    """POST /jobs/{id}/cancel, and wait, so that the service has nothing to hand back."""
    _say(f"POST {job['links']['cancel']}")
    try:
        _answer(Request(f"{url}{job['links']['cancel']}", method="POST"))  # noqa: S310
        _answer(f"{url}{job['links']['self']}?wait=10")
    except DemoFailed as error:
        _say(f"{error}; the service is stopped all the same")


def fetch(url: str, job: Job, out: Path) -> None:
    """GET every file of the result."""
    files = job["artifacts"]
    _say(f"fetching {len(files)} files of the result")
    for name, file in files.items():
        path = out / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(_answer(f"{url}{quote(file['href'])}"))


def _answer(request: Request | str) -> bytes:
    """The body of the answer; an error's problem document becomes the message."""
    try:
        with urlopen(request, timeout=60) as response:  # noqa: S310
            body: bytes = response.read()
            return body
    except HTTPError as error:
        problem = json.loads(error.read() or b"{}")
        detail = problem.get("detail", error.reason)
        advice = problem.get("advice") or ""
        raise DemoFailed(
            f"{detail} [{problem.get('code', error.code)}] {advice}".strip()
        ) from error
    except URLError as error:
        raise DemoFailed(f"the service does not answer: {error.reason}") from error


class ProgressLine:
    """One live line on a terminal; a plain line every few seconds elsewhere."""

    def __init__(self) -> None:
        self.live = sys.stderr.isatty()
        self.last_text, self.last_time = "", 0.0

    def show(self, job: Job) -> None:
        """The job as it stands."""
        text = f"  {self.text(job)}"
        if self.live:
            click.echo(f"\r\033[K{text}", nl=False, err=True)
        elif text != self.last_text and time.monotonic() - self.last_time >= PLAIN_SECONDS:
            self.last_text, self.last_time = text, time.monotonic()
            click.echo(text, err=True)

    def text(self, job: Job) -> str:
        """State, and how far it is."""
        progress = job["progress"]
        if progress is None:
            return str(job["state"])
        parts = [f"{progress['fraction']:4.0%}  {progress['stage']}"]
        if progress["iteration"] is not None:
            parts.append(f"iteration {progress['iteration']} of {progress['iterations']}")
        if progress["loss"] is not None:
            parts.append(f"loss {progress['loss']:.4f}")
        if progress["eta"] is not None:
            parts.append(f"{progress['eta']:.0f} s of this stage left")
        return "  ".join(parts)

    def end(self) -> None:
        """Leave a clean line."""
        if self.live:
            click.echo("\r\033[K", nl=False, err=True)


def draw(cloud_path: Path, mesh_path: Path, picture: Path) -> None:
    """The cloud and the surface from the same place, side by side."""
    import trimesh
    from trimesh.visual.color import ColorVisuals

    from mpf_core.cloud.reader import read_cloud
    from mpf_core.quality.raster import Camera
    from mpf_core.quality.render import render, render_points, side_by_side
    from mpf_core.surface.mesh import Mesh

    cloud = read_cloud(cloud_path)
    loaded = trimesh.load_mesh(mesh_path, process=False)
    vertices, faces = loaded.vertices.view(), loaded.faces.view()
    visual = loaded.visual
    colors = visual.vertex_colors[:, :3] if isinstance(visual, ColorVisuals) else None
    if cloud.colors is None:
        colors = None  # the loader paints what has no colours
    unoriented = ", without normals" if cloud.normals is None else ""
    camera = Camera.around(cloud.points, size=(900, 900))
    side_by_side(
        [
            render_points(cloud, camera=camera),
            render(Mesh(vertices, faces, None, colors), camera=camera),
        ],
        [f"{len(cloud.points):,} points{unoriented}", f"{len(faces):,} triangles"],
    ).save(picture, optimize=True)


def _make_sample(name: str | None, out: Path) -> Path:
    """`mpf sample`, as a command."""
    path = out / "cloud.ply"
    _say(f"making a sample cloud: mpf sample {f'{name} ' if name else ''}-o {path}")
    command = [
        sys.executable,
        "-m",
        "mpf_core",
        "sample",
        *([name] if name else []),
        "-o",
        str(path),
    ]
    if subprocess.run(command, check=False).returncode:  # noqa: S603
        raise DemoFailed("there is no sample cloud to send")
    return path


def _remove_old(out: Path) -> None:
    """What an earlier demo left, so that nothing of it is taken for the new result."""
    names = ("mesh.glb", "mesh.ply", "field.safetensors", "report.json", "picture.png")
    for path in (*(out / name for name in names), *out.glob("slices/[xyz]/*.png")):
        path.unlink(missing_ok=True)


def _tell(out: Path, seconds: float) -> None:
    """The result in words, and where to look at it."""
    from mpf_core.cli import summary

    report = json.loads((out / "report.json").read_text())
    click.echo(summary(report, out / "mesh.glb", sum(report["timings"].values())))
    click.echo(f"\nAfter {seconds:.0f} s in all, {out}/ holds")
    for name, about in (
        ("picture.png", "the points and the surface"),
        ("mesh.glb", "the surface for viewers and browsers"),
        ("mesh.ply", "the surface for tools that measure"),
        ("field.safetensors", "the fitted field, for mpf extract and mpf slice"),
        ("slices/", "cuts through the field φ, along x, y and z"),
        ("report.json", "options, timings, distances, topology"),
        ("service.log", "what the service said"),
    ):
        click.echo(f"  {name:<19}{about}")


def _say(text: str) -> None:
    click.echo(f"demo: {text}", err=True)


def _leave(number: int, _frame: FrameType | None) -> None:
    """A signal ends the demo as Ctrl-C does: everything on the way out is still done."""
    sys.exit(128 + number)


if __name__ == "__main__":
    main()
