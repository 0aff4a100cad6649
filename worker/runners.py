"""What the attempts at a job do, by what there is to be done. The numerics are loaded in here and
nowhere else."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from mpf_core.extraction_options import extraction_from
from mpf_core.options import Options, options_from
from mpf_core.progress import Progress, ProgressCallback
from mpf_core.tiles.count import tile_count
from service.jobs.model import EXTRACTION, FIT, TILE, Job
from worker.report import Reporter

SPLIT = "split"
"""The first part of a fit whose cloud is too large for one: its tiles are made."""
JOIN = "join"
"""The last part of such a fit: one surface from the fields of its tiles."""


@dataclass(frozen=True)
class Gathered:
    """What there is to be joined: folders of this machine.

    plan: what the split has left; fitted: what the fits of the tiles have left, in their order
    """

    plan: Path
    fitted: tuple[Path, ...]


@dataclass(frozen=True)
class Run:
    """One attempt at one job, with what it needs."""

    job: Job
    threads: int
    """For where the job's options leave it open."""
    input: Path
    out: Path
    reporter: Reporter
    preview: Callable[[bytes], None]
    checkpoint: Path
    gathered: Gathered | None = None
    """Of a join only."""

    def options(self) -> Options:
        """The job's options of a fit, with its threads."""
        options = options_from(self.job.options)
        return replace(options, threads=options.threads or self.threads)


Runner = Callable[[Run], None]


def work_of(job: Job, given: Path) -> str:
    """What there is to be done: a key of `RUNNERS`.

    given: the job's input, whose points are counted if nobody has done so.
    """
    if job.kind != FIT:
        return job.kind
    if job.split:
        return JOIN
    return SPLIT if is_large(job, given) else FIT


def is_large(job: Job, given: Path) -> bool:
    """Whether the cloud is more than one fit holds."""
    from mpf_core.cloud.reader import read_cloud

    options = options_from(job.options)
    if tile_count(sys.maxsize, options) == 1:
        return False
    points = job.input.points if job.input is not None else None
    if points is None:
        points = len(read_cloud(given))
    return tile_count(points, options) > 1


def fit(run: Run) -> None:
    """Points in, surface out."""
    from mpf_core.results import reconstruct_file

    reconstruct_file(
        run.input,
        run.out,
        run.options(),
        progress=run.reporter.progress,
        stop=run.reporter.stop,
        cancel=run.reporter.cancel,
        checkpoint=run.checkpoint,
        preview=run.preview,
    )


def extract(run: Run) -> None:
    """A fitted field in, a mesh or slices out."""
    from mpf_core.reuse import extract_file

    options = extraction_from(run.job.options)
    extract_file(
        run.input,
        run.out,
        replace(options, threads=options.threads or run.threads),
        progress=run.reporter.progress,
        cancel=run.reporter.cancel,
    )


def split(run: Run) -> None:
    """Points in, a plan and tiles out."""
    from mpf_core.tiles import split_file

    split_file(run.input, run.out, run.options(), progress=_told(run), cancel=run.reporter.cancel)


def fit_tile(run: Run) -> None:
    """A tile in, its field out; a short fit if the job is to be kept before this has begun."""
    from mpf_core.tiles.child import fit_tile_in_time

    fit_tile_in_time(
        run.input,
        run.out,
        run.options(),
        progress=run.reporter.progress,
        stop=run.reporter.stop,
        cancel=run.reporter.cancel,
        checkpoint=run.checkpoint,
    )


def join(run: Run) -> None:
    """Fields of tiles in, surface out."""
    from mpf_core.tiles import join_files
    from mpf_core.tiles.child import FIELD

    assert run.gathered is not None
    join_files(
        run.gathered.plan,
        [folder / FIELD for folder in run.gathered.fitted],
        run.input,
        run.out,
        run.options(),
        progress=_told(run),
        cancel=run.reporter.cancel,
    )


def _told(run: Run) -> ProgressCallback:
    """Progress in the stages that callers know."""
    from mpf_core.tiles.run import STAGE

    def tell(progress: Progress) -> None:
        run.reporter.progress(replace(progress, stage=STAGE.get(progress.stage, progress.stage)))

    return tell


RUNNERS: dict[str, Runner] = {
    FIT: fit, EXTRACTION: extract, SPLIT: split, TILE: fit_tile, JOIN: join,
}  # fmt: skip
