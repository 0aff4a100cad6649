"""Inputs and results in an object store: what API and workers on several machines share.

    jobs/{job}/input.{format}           what was uploaded
    jobs/{job}/result-{attempt}/{name}  what an attempt published …
    jobs/{job}/result-{attempt}.json    … and the list of it, written last: without it there is none
    jobs/{job}/preview-{attempt}.glb    a mesh of what is not finished
    jobs/{job}/checkpoint-{attempt}     the state of its fit, for the next attempt to go on from

An object store has no rename, but each object appears at once, so the list is the moment at which
a result is there. On this machine there are only bodies on their way in and the folders of running
attempts:

    uploads/{token}
    work/{job}-{attempt}/               input, output and checkpoint of an attempt
"""

from __future__ import annotations

import fcntl
import json
import logging
import re
import secrets
import shutil
import threading
from collections import OrderedDict
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import asdict
from pathlib import Path
from typing import IO

from service.artifacts.base import Artifacts, Blob, Published
from service.artifacts.bucket import Bucket, Entry
from service.artifacts.store import measured, remove_older
from service.jobs.model import Artifact

log = logging.getLogger("mpf.store")

_JOB_ID = re.compile(r"[0-9a-f]{32}")

AT_ONCE = 8
"""Files of a result on their way at the same time: most are small pictures."""

KEEP_SECONDS = 1.0
"""How often it is looked whether a checkpoint was written."""

LISTS_KEPT = 1000
"""Lists of results that a process remembers; they never change."""


class ObjectBlob(Blob):
    """An object."""

    def __init__(self, bucket: Bucket, entry: Entry, link_seconds: float):
        self._bucket = bucket
        self._key = entry.key
        self.name = entry.key.rpartition("/")[2]
        self._link_seconds = link_seconds
        self.size = entry.size
        self.modified = entry.modified

    def read(self, start: int = 0, end: int | None = None) -> Iterator[bytes]:
        """Its bytes."""
        return self._bucket.read(self._key, start, self.size if end is None else end)

    def link(self) -> str | None:
        """A URL that reads it for a while."""
        return self._bucket.link(self._key, self._link_seconds)


class ObjectArtifacts(Artifacts):
    """The files of all jobs in a bucket, and a folder of this machine for what passes through."""

    look_seconds = 900.0  # listing is slow, and charged for

    def __init__(self, bucket: Bucket, scratch: Path, link_seconds: float = 900.0):
        self._bucket = bucket
        self._uploads = scratch / "uploads"
        self._work = scratch / "work"
        self._link_seconds = link_seconds
        self._lists: OrderedDict[str, dict[str, Entry]] = OrderedDict()
        self._held: dict[Path, IO[bytes]] = {}

    def prepare(self) -> None:
        """Make the folders of this machine."""
        for folder in (self._uploads, self._work):
            folder.mkdir(parents=True, exist_ok=True)
            folder.chmod(0o700)

    def check_writable(self) -> None:
        """Write a small object."""
        self._bucket.put("probe", b"mpf")

    def free_fraction(self) -> float:
        """Nobody can tell; a full disk of this machine is met when it is written to."""
        return 1.0

    # Inputs

    def new_upload(self) -> Path:
        """A path on this machine for a body on its way in."""
        return self._uploads / secrets.token_hex(16)

    def adopt_input(self, job_id: str, upload: Path, format_: str) -> None:
        """Put a complete upload into the store."""
        name = f"input.{format_}"
        self._bucket.put_file(f"{_folder(job_id)}/{name}", upload, _headers(job_id, name))

    def share_input(self, parent: str, job_id: str) -> None:
        """Copy the input of another job, within the store; a link still gives that job's name."""
        source = self._input(parent).key
        self._bucket.copy(source, f"{_folder(job_id)}/{source.rpartition('/')[2]}")

    def share_field(self, parent: str, attempt: int, name: str, job_id: str) -> None:
        """Copy a file of another job's result, within the store."""
        source = self._published(parent, attempt, name).key
        self._bucket.copy(source, f"{_folder(job_id)}/input{Path(name).suffix}")

    def input(self, job_id: str, attempt: int) -> Path:
        """Fetch the input for this attempt."""
        entry = self._input(job_id)
        path = self._attempt(job_id, attempt) / entry.key.rpartition("/")[2]
        self._bucket.fetch(entry, path)
        return path

    def given(self, job_id: str) -> ObjectBlob:
        """The object that was uploaded or copied."""
        return ObjectBlob(self._bucket, self._input(job_id), self._link_seconds)

    def _input(self, job_id: str) -> Entry:
        for entry in self._bucket.children(_folder(job_id))[1]:
            if entry.key.rpartition("/")[2].startswith("input."):
                return entry
        raise FileNotFoundError(job_id)

    # Results

    def work(self, job_id: str, attempt: int) -> Path:
        """An empty folder on this machine for an attempt to write into."""
        folder = self._attempt(job_id, attempt) / "out"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        return folder

    def publish(self, job_id: str, attempt: int) -> dict[str, Artifact]:
        """Put all files into the store, and their list when all of them are there."""
        work = self._attempt(job_id, attempt) / "out"
        files = sorted(path for path in work.rglob("*") if path.is_file())
        found = {path.relative_to(work).as_posix(): measured(path) for path in files}
        target = f"{_folder(job_id)}/result-{attempt}"

        def put(name: str) -> None:
            self._bucket.put_file(f"{target}/{name}", work / name, _headers(job_id, name))

        with ThreadPoolExecutor(AT_ONCE, thread_name_prefix="publish") as pool:
            for _ in pool.map(put, found):
                pass
        told = {"files": {name: asdict(about) for name, about in found.items()}}
        self._bucket.put(f"{target}.json", json.dumps(told).encode())
        return found

    def result(self, job_id: str, attempt: int, name: str) -> ObjectBlob:
        """An object of a published result."""
        return ObjectBlob(
            self._bucket, self._published(job_id, attempt, name), self._link_seconds
        )  # fmt: skip

    def _published(self, job_id: str, attempt: int, name: str) -> Entry:
        files = self._listed(job_id, attempt)
        if name not in files:
            raise FileNotFoundError(name)
        return files[name]

    def _listed(self, job_id: str, attempt: int) -> dict[str, Entry]:
        """What the list of a result names; raises FileNotFoundError."""
        target = f"{_folder(job_id)}/result-{attempt}"
        files = self._lists.get(target)
        if files is None:
            entry = self._bucket.entry(f"{target}.json")
            told = json.loads(self._bucket.get(entry.key))["files"]
            files = {n: Entry(f"{target}/{n}", a["bytes"], entry.modified) for n, a in told.items()}
            self._lists[target] = files
            while len(self._lists) > LISTS_KEPT:
                with suppress(KeyError):  # another thread was first
                    self._lists.popitem(last=False)
        return files

    def local_result(
        self, source: Published, job_id: str, attempt: int, *, but: str | None = None
    ) -> Path:
        """What is needed of it, fetched into the attempt's folder."""
        folder = self._attempt(job_id, attempt) / "given" / f"{source.job_id}-{source.attempt}"
        for name, entry in self._listed(source.job_id, source.attempt).items():
            if but is not None and name.startswith(but):
                continue
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            self._bucket.fetch(entry, path)
        return folder

    def forget_results(self, job_id: str, *, but: int) -> None:
        """Remove the objects of all attempts except `but`, and their lists."""
        start = f"{_folder(job_id)}/result-"
        keys = [entry.key for entry in self._bucket.below(_folder(job_id))]
        kept = (f"{start}{but}.json", f"{start}{but}/")
        self._bucket.delete([k for k in keys if k.startswith(start) and not k.startswith(kept)])

    def write_preview(self, job_id: str, attempt: int, glb: bytes) -> None:
        """Put the latest mesh of an unfinished fit in place of the one before."""
        self._bucket.put(_preview(job_id, attempt), glb)

    def read_preview(self, job_id: str, attempt: int) -> bytes:
        """That mesh."""
        return self._bucket.get(_preview(job_id, attempt))

    @contextmanager
    def checkpoint(self, job_id: str, attempt: int, *, inherit: bool = True) -> Iterator[Path]:
        """A file of this machine; whenever it was written, the store gets it too."""
        path = self._attempt(job_id, attempt) / "checkpoint"
        if inherit:
            self._inherit(job_id, attempt, path)
        keeper = _Keeper(self._bucket, path, f"{_folder(job_id)}/checkpoint-{attempt}")
        keeper.start()
        try:
            yield path
        finally:
            keeper.stop()

    def _inherit(self, job_id: str, attempt: int, path: Path) -> None:
        kept = {
            int(number): entry
            for entry in self._bucket.children(_folder(job_id))[1]
            if (number := entry.key.rpartition("/checkpoint-")[2]).isdigit()
        }
        older = [number for number in kept if number < attempt]
        if older and not path.exists():
            with suppress(FileNotFoundError):
                self._bucket.fetch(kept[max(older)], path)

    def forget_checkpoints(self, job_id: str) -> None:
        """Remove those of all attempts."""
        entries = self._bucket.children(_folder(job_id))[1]
        self._bucket.delete([entry.key for entry in entries if "/checkpoint-" in entry.key])

    def discard_work(self, job_id: str, attempt: int) -> None:
        """Remove the attempt's folder and its preview."""
        folder = self._work / f"{job_id}-{attempt}"
        shutil.rmtree(folder, ignore_errors=True)
        held = self._held.pop(folder, None)
        if held is not None:
            held.close()
        self._bucket.delete([_preview(job_id, attempt)])

    # Removal

    def remove(self, job_id: str) -> None:
        """Remove all objects of a job."""
        self._bucket.delete([entry.key for entry in self._bucket.below(_folder(job_id))])

    def job_ids(self) -> Iterator[str]:
        """The jobs that have objects."""
        yield from (name for name in self._bucket.children("jobs")[0] if _JOB_ID.fullmatch(name))

    def age(self, job_id: str, now: float) -> float:
        """Seconds since an object of the job was written."""
        written = [entry.modified for entry in self._bucket.below(_folder(job_id))]
        if not written:
            raise FileNotFoundError(job_id)
        return now - max(written)

    def remove_leftovers(self, older_than: float) -> Iterator[str]:
        """Remove bodies and attempts' folders whose process has died."""
        yield from remove_older(self._uploads, older_than)
        with suppress(FileNotFoundError):
            for folder in list(self._work.iterdir()):
                with suppress(FileNotFoundError):
                    if folder.stat().st_mtime < older_than and _abandoned(folder):
                        shutil.rmtree(folder, ignore_errors=True)
                        yield folder.name

    def _attempt(self, job_id: str, attempt: int) -> Path:
        """The attempt's folder, which belongs to this process as long as it lives."""
        folder = self._work / f"{_folder(job_id).rpartition('/')[2]}-{attempt}"
        if folder not in self._held:
            folder.mkdir(parents=True, exist_ok=True)
            self._held[folder] = (folder / "lock").open("wb")
            fcntl.flock(self._held[folder], fcntl.LOCK_EX)
        return folder


class _Keeper:
    """Puts a checkpoint into the store whenever it has been written; a lost one ends nothing."""

    def __init__(self, bucket: Bucket, path: Path, key: str):
        self._bucket = bucket
        self._path = path
        self._key = key
        self._kept = self._written()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="checkpoint", daemon=True)

    def start(self) -> None:
        """Begin to look."""
        self._thread.start()

    def stop(self) -> None:
        """Keep the last one, too."""
        self._over.set()
        self._thread.join()
        self._keep()

    def _run(self) -> None:
        while not self._over.wait(KEEP_SECONDS):
            self._keep()

    def _keep(self) -> None:
        written = self._written()
        if written == self._kept:
            return
        try:
            self._bucket.put_file(self._key, self._path)
            self._kept = written
        except OSError as error:
            log.warning("checkpoint not kept: %s", error)

    def _written(self) -> int:
        try:
            return self._path.stat().st_mtime_ns
        except FileNotFoundError:
            return 0


def _abandoned(folder: Path) -> bool:
    """Whether the process that worked in this folder has ended."""
    with (folder / "lock").open("ab") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
    return True


def _folder(job_id: str) -> str:
    if not _JOB_ID.fullmatch(job_id):
        raise FileNotFoundError(job_id)
    return f"jobs/{job_id}"


def _preview(job_id: str, attempt: int) -> str:
    return f"{_folder(job_id)}/preview-{attempt}.glb"


MEDIA_TYPES = {".glb": "model/gltf-binary", ".json": "application/json", ".png": "image/png"}


def _headers(job_id: str, name: str) -> dict[str, str]:
    """What the store itself tells those who come by a link.

    Never inline: an input must not become a page, and a file that is saved must not replace one.
    """
    kind = MEDIA_TYPES.get(Path(name).suffix)
    return {
        "Content-Type": kind or "application/octet-stream",
        "Content-Disposition": f'attachment; filename="{job_id[:8]}-{name.replace("/", "-")}"',
        "Cache-Control": "private, max-age=31536000, immutable",
    }
