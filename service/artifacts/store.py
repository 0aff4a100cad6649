"""Inputs and results as files on local disk, each of them whole or not there.

    uploads/{token}               a body on its way in
    jobs/{job}/input.{format}     what was uploaded
    jobs/{job}/work-{attempt}/    what an attempt is writing
    jobs/{job}/result-{attempt}/  what it published
    jobs/{job}/preview-{attempt}.glb  a mesh of what is not finished
    jobs/{job}/checkpoint-{attempt}   the state of its fit, for the next attempt to go on from

Any number of processes may use it, on all machines that see the folder.
"""

from __future__ import annotations

import hashlib
import os
import re
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath

from mpf_core.files import write_atomically
from service.artifacts.base import CHUNK_BYTES, Artifacts, Blob, Published
from service.jobs.model import Artifact

_JOB_ID = re.compile(r"[0-9a-f]{32}")


class FileBlob(Blob):
    """A file of a folder."""

    def __init__(self, path: Path):
        about = path.stat()
        self._path = path
        self.name = path.name
        self.size = about.st_size
        self.modified = about.st_mtime

    @property
    def path(self) -> Path:
        """Where it lies."""
        return self._path

    def read(self, start: int = 0, end: int | None = None) -> Iterator[bytes]:
        """Its bytes."""
        left = (self.size if end is None else end) - start
        with self._path.open("rb") as file:
            file.seek(start)
            while left > 0 and (chunk := file.read(min(CHUNK_BYTES, left))):
                left -= len(chunk)
                yield chunk


class ArtifactStore(Artifacts):
    """The files of all jobs below one folder."""

    def __init__(self, root: Path):
        self.root = root
        self._uploads = root / "uploads"
        self._jobs = root / "jobs"

    def prepare(self) -> None:
        """Make the folders; raises OSError if that cannot be done."""
        for folder in (self._uploads, self._jobs):
            folder.mkdir(parents=True, exist_ok=True)
            folder.chmod(0o700)  # what people upload is nobody else's business

    def check_writable(self) -> None:
        """Write and remove a small file; raises OSError if the disk is full or read-only."""
        probe = self._uploads / f"probe-{secrets.token_hex(8)}"
        try:
            with probe.open("wb") as file:
                file.write(b"mpf")
                os.fsync(file.fileno())
        finally:
            probe.unlink(missing_ok=True)

    def free_fraction(self) -> float:
        """Share of the disk that is free; 1 before the folders exist."""
        try:
            usage = shutil.disk_usage(self._jobs)
        except FileNotFoundError:
            return 1.0
        return usage.free / usage.total

    # Inputs

    def new_upload(self) -> Path:
        """A path for a body on its way in."""
        return self._uploads / secrets.token_hex(16)

    def adopt_input(self, job_id: str, upload: Path, format_: str) -> None:
        """Make a complete upload the input of a job; on return it is on the disk."""
        folder = self._folder(job_id)
        folder.mkdir()
        target = folder / f"input.{format_}"
        _sync(upload)
        upload.rename(target)
        for changed in (folder, self._jobs):
            _sync(changed)

    def share_input(self, parent: str, job_id: str) -> None:
        """Give a job the input of another one, without copying the bytes."""
        source = self.input(parent)
        self._share(source, job_id, source.name)

    def share_field(self, parent: str, attempt: int, name: str, job_id: str) -> None:
        """Make a file of another job's result the input of a job, as `share_input` does."""
        source = self.result(parent, attempt, name).path
        self._share(source, job_id, f"input{source.suffix}")

    def _share(self, source: Path, job_id: str, name: str) -> None:
        folder = self._folder(job_id)
        folder.mkdir()
        target = folder / name
        target.hardlink_to(source)
        for changed in (folder, self._jobs):
            _sync(changed)

    def input(self, job_id: str, attempt: int = 0) -> Path:  # noqa: ARG002  all attempts read it
        """The input of a job; raises FileNotFoundError if there is none."""
        for path in self._folder(job_id).glob("input.*"):
            return path
        raise FileNotFoundError(job_id)

    def given(self, job_id: str) -> FileBlob:
        """The input of a job; raises FileNotFoundError if there is none."""
        return FileBlob(self.input(job_id))

    # Results

    def work(self, job_id: str, attempt: int) -> Path:
        """An empty folder for an attempt to write into."""
        folder = self._folder(job_id) / f"work-{attempt}"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        return folder

    def publish(self, job_id: str, attempt: int) -> dict[str, Artifact]:
        """Make what the attempt wrote its result, at once and durably; its files by name."""
        work = self._folder(job_id) / f"work-{attempt}"
        files = sorted(path for path in work.rglob("*") if path.is_file())
        found = {path.relative_to(work).as_posix(): measured(path) for path in files}
        for path in [*work.rglob("*"), work]:
            _sync(path)
        work.rename(self._folder(job_id) / f"result-{attempt}")
        _sync(self._folder(job_id))
        return found

    def result(self, job_id: str, attempt: int, name: str) -> FileBlob:
        """The file of a published result; raises FileNotFoundError if it has none of that name."""
        root = self._folder(job_id) / f"result-{attempt}"
        if ".." in PurePosixPath(name).parts:
            raise FileNotFoundError(name)
        path = root / name
        if not path.is_file():
            raise FileNotFoundError(name)
        return FileBlob(path)

    def local_result(
        self,
        source: Published,
        job_id: str,  # noqa: ARG002  all attempts read it where it lies: nobody writes to it
        attempt: int,  # noqa: ARG002
        *,
        but: str | None = None,  # noqa: ARG002
    ) -> Path:
        """The folder where it lies."""
        folder = self._folder(source.job_id) / f"result-{source.attempt}"
        if not folder.is_dir():
            raise FileNotFoundError(folder)
        return folder

    def forget_results(self, job_id: str, *, but: int) -> None:
        """Remove the folders of all attempts except `but`."""
        for path in self._folder(job_id).glob("result-*"):
            if path.name != f"result-{but}":
                shutil.rmtree(path, ignore_errors=True)

    def write_preview(self, job_id: str, attempt: int, glb: bytes) -> None:
        """Put the latest mesh of an unfinished fit in place of the one before."""
        write_atomically(self._preview(job_id, attempt), glb)

    def read_preview(self, job_id: str, attempt: int) -> bytes:
        """That mesh; raises FileNotFoundError if there is none."""
        return self._preview(job_id, attempt).read_bytes()

    @contextmanager
    def checkpoint(self, job_id: str, attempt: int, *, inherit: bool = True) -> Iterator[Path]:
        """A file that is where the next attempt looks for it."""
        path = self._folder(job_id) / f"checkpoint-{attempt}"
        if inherit and not path.exists():
            for older in range(attempt - 1, 0, -1):
                with suppress(FileNotFoundError):
                    path.hardlink_to(path.with_name(f"checkpoint-{older}"))
                    break
        yield path

    def forget_checkpoints(self, job_id: str) -> None:
        """The job has ended: nobody will go on from where it was."""
        for path in self._folder(job_id).glob("checkpoint-*"):
            path.unlink(missing_ok=True)

    def discard_work(self, job_id: str, attempt: int) -> None:
        """Remove what an attempt wrote without publishing it."""
        self._preview(job_id, attempt).unlink(missing_ok=True)
        shutil.rmtree(self._folder(job_id) / f"work-{attempt}", ignore_errors=True)

    # Removal

    def remove(self, job_id: str) -> None:
        """Remove all files of a job."""
        shutil.rmtree(self._folder(job_id), ignore_errors=True)

    def job_ids(self) -> Iterator[str]:
        """The jobs that have files."""
        with suppress(FileNotFoundError):
            yield from (p.name for p in self._jobs.iterdir() if _JOB_ID.fullmatch(p.name))

    def age(self, job_id: str, now: float) -> float:
        """Seconds since the folder of a job was last written to."""
        return now - self._folder(job_id).stat().st_mtime

    def remove_leftovers(self, older_than: float) -> Iterator[str]:
        """Remove bodies that were on their way in when their process died; their names."""
        yield from remove_older(self._uploads, older_than)

    def _preview(self, job_id: str, attempt: int) -> Path:
        return self._folder(job_id) / f"preview-{attempt}.glb"

    def _folder(self, job_id: str) -> Path:
        if not _JOB_ID.fullmatch(job_id):
            raise FileNotFoundError(job_id)
        return self._jobs / job_id


def remove_older(folder: Path, than: float) -> Iterator[str]:
    """Remove the files of a folder that nobody has written to since; their names.

    than: s since 1970.
    """
    with suppress(FileNotFoundError):
        for path in list(folder.iterdir()):
            with suppress(FileNotFoundError):
                if path.stat().st_mtime < than:
                    path.unlink()
                    yield path.name


def measured(path: Path) -> Artifact:
    """Size and SHA-256 of a file."""
    with path.open("rb") as file:
        return Artifact(path.stat().st_size, hashlib.file_digest(file, "sha256").hexdigest())


def _sync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
