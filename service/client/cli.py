"""`mpf submit`, `mpf jobs`, `mpf cancel`: a service from a terminal."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mpf_core.options import PRESET_NAMES
from mpf_core.progress import Progress
from mpf_core.terminal import ProgressLine, changes_in, check_output, told_errors

if TYPE_CHECKING:
    from service.client import Client, Job

EXIT_REFUSED, EXIT_UNREACHABLE = 4, 5
MEGABYTE = 1e6


def at_a_service(command: Callable[..., Any]) -> Callable[..., Any]:
    """The options that say where the service is."""
    command = click.option(
        "--key", envvar="MPF_API_KEY", help="API key, where one is needed (MPF_API_KEY)."
    )(command)
    return click.option(
        "--server", envvar="MPF_SERVER", default="http://127.0.0.1:8000", show_default=True,
        help="Where the service is (MPF_SERVER).",
    )(command)  # fmt: skip


@click.command()
@click.argument("cloud", type=click.Path(path_type=Path))
@at_a_service
@click.option("--preset", type=click.Choice(PRESET_NAMES), help="The options to start from.")
@click.option("--set", "settings", multiple=True, metavar="NAME=VALUE",
              help="Any option by its name, e.g. --set resolution=320.")  # fmt: skip
@click.option("--label", default="", help="A word to find the job by.")
@click.option("--wait", is_flag=True, help="Follow the job until it has ended.")
@click.option("-o", "--output", type=click.Path(path_type=Path, dir_okay=False),
              help="Mesh to fetch: .glb or .ply; waits.")  # fmt: skip
@click.option("--report", type=click.Path(path_type=Path, dir_okay=False),
              help="JSON file for the report; waits.")  # fmt: skip
@click.option("--resume", metavar="UPLOAD", help="Go on with an upload that was interrupted.")
def submit(
    cloud: Path,
    server: str,
    key: str | None,
    label: str,
    wait: bool,
    output: Path | None,
    report: Path | None,
    resume: str | None,
    **flags: Any,
) -> None:
    """Send CLOUD to a service and print the job's id."""
    with told_errors(cloud), connected(server, key) as service:
        if output is not None:
            check_output(output, ".glb", ".ply")
        if report is not None:
            check_output(report, option="--report")
        job = _sent(service, cloud, changes_in(flags), label, resume)
        click.echo(job.id)
        if not (wait or output or report):
            return
        job = _followed(service, job)
        if output is not None:
            _fetch(service, job, f"mesh{output.suffix.lower()}", output)
        if report is not None:
            _fetch(service, job, "report.json", report)


@click.command()
@at_a_service
@click.option("--state", "states", multiple=True, help="Only these; may be given several times.")
@click.option("--label", help="Only jobs with this label.")
@click.option("--limit", type=click.IntRange(1, 10_000), default=20, show_default=True)
@click.option("--json", "as_json", is_flag=True, help="One JSON object per line.")
def jobs(
    server: str, key: str | None, states: tuple[str, ...], label: str | None, limit: int,
    as_json: bool,
) -> None:  # fmt: skip
    """List one's jobs, newest first."""
    with connected(server, key) as service:
        for job in service.jobs(states=states, label=label, limit=limit):
            click.echo(job.model_dump_json() if as_json else line_of(job))


@click.command()
@click.argument("job_ids", nargs=-1, required=True, metavar="JOB…")
@at_a_service
@click.option("--keep", is_flag=True, help="Have the surface so far as the result.")
def cancel(job_ids: tuple[str, ...], server: str, key: str | None, keep: bool) -> None:
    """Stop jobs that wait or run."""
    with connected(server, key) as service:
        for job_id in job_ids:
            click.echo(line_of(service.cancel(job_id, keep=keep)))


@contextmanager
def connected(server: str, key: str | None) -> Iterator[Client]:
    """A client; what it raises ends the process with a sentence."""
    from service.client import Client, Refused, Unreachable

    try:
        with Client(server, key) as service:
            yield service
    except Refused as refusal:
        advice = f" {refusal.problem.advice}" if refusal.problem.advice else ""
        click.echo(f"mpf: {refusal.problem.detail}.{advice} [{refusal.code}]", err=True)
        sys.exit(EXIT_REFUSED)
    except Unreachable as error:
        click.echo(f"mpf: {error}", err=True)
        sys.exit(EXIT_UNREACHABLE)


def line_of(job: Job) -> str:
    """One job on one line."""
    name = job.input.name if job.input else ""
    parts = [job.id, f"{job.state:9}", f"{job.created_at:%Y-%m-%d %H:%M}", name]
    if job.label:
        parts.append(f"({job.label})")
    if job.state == "running" and job.progress is not None:
        parts.append(f"{job.progress.fraction:.0%} {job.progress.stage}")
    if job.queue_position:
        parts.append(f"{job.queue_position} before it")
    if job.eta is not None and not job.problem:
        parts.append(f"{job.eta:.0f} s left")
    if job.problem is not None:
        parts.append(job.problem.code)
    return "  ".join(parts)


def _sent(
    service: Client, cloud: Path, options: dict[str, Any], label: str, resume: str | None
) -> Job:
    line = _Line()
    began: list[str] = []
    try:
        return service.submit(
            cloud, options, label=label, upload=resume, moved=line.moved, began=began.append
        )
    except BaseException:
        if began and line.left:
            click.echo(f"mpf: interrupted; go on with --resume {began[0]}", err=True)
        raise
    finally:
        line.end()


def _followed(service: Client, job: Job) -> Job:
    from service.client import Refused

    line = _Line()
    job = service.wait(job.id, line.looked)
    line.end()
    if job.problem is not None:
        raise Refused(job.problem)
    return job


def _fetch(service: Client, job: Job, name: str, path: Path) -> None:
    if name not in job.artifacts:
        raise click.ClickException(f"job {job.id} has no {name}")
    line = _Line()
    service.download(job, name, path, line.moved)
    line.end()


class _Line(ProgressLine):
    """The progress of an upload, of a job and of a download."""

    def __init__(self) -> None:
        super().__init__()
        self.left = False

    def moved(self, done: int, size: int) -> None:
        """So many bytes have arrived."""
        self.left = done < size
        if self.live:
            text = f"{done / max(1, size):4.0%}  {done / MEGABYTE:.1f} of {size / MEGABYTE:.1f} MB"
            click.echo(f"\r\033[K{text}", nl=False, err=True)

    def looked(self, job: Job) -> None:
        """The job stands so."""
        if job.progress is not None:
            told = job.progress
            self.show(
                Progress(
                    told.stage, told.fraction, told.seconds, eta=told.eta, loss=told.loss,
                    iteration=told.iteration, iterations=told.iterations,
                )
            )  # fmt: skip
        elif self.live and job.state == "queued":
            eta = "" if job.eta is None else f"  {job.eta:.0f} s left"
            click.echo(f"\r\033[K  0%  queued, {job.queue_position} before it{eta}",
                       nl=False, err=True)  # fmt: skip
