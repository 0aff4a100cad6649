"""Uploads that survive a lost connection: their bytes arrive in pieces, over any replica.

    resumable/{id}/about.json   whose it is, how long it will be, its name; written once
    resumable/{id}/data         the bytes so far
    resumable/{id}/piece        a piece that is not believed before its checksum is known

The offset is the size of `data` and stands nowhere else, so that no kill can make the two disagree.
One writer at a time, by a lock on `data` that the kernel drops with its process.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import IO

from mpf_core.cloud.limits import Limits
from mpf_core.errors import MPFError
from mpf_core.files import write_atomically
from service.problems import Problem
from service.settings import Settings
from service.uploads.header import HEADER_BYTES, peek
from service.uploads.incoming import (
    UPLOAD_ID,
    Checksum,
    Resumable,
    Upload,
    Writer,
    elsewhere,
    incomplete,
    locked,
    not_found,
    too_many,
    wrong_checksum,
)
from service.uploads.sink import Stored


class ResumableStore(Resumable):
    """The uploads below one folder."""

    def __init__(self, root: Path, settings: Settings):
        self._root = root / "resumable"
        self._limits = Limits(max_bytes=settings.upload_bytes, max_points=settings.max_points)
        self._low = settings.disk_low_fraction
        self._seconds = settings.resumable_seconds

    def prepare(self) -> None:
        """Make the folder; raises OSError if that cannot be done."""
        self._root.mkdir(parents=True, exist_ok=True)
        self._root.chmod(0o700)

    def create(self, owner: str, length: int, name: str, metadata: str) -> Upload:
        """Begin an upload of `length` bytes; raises Problem where there is no room for it."""
        disk = shutil.disk_usage(self._root)
        if disk.free - length < self._low * disk.total:
            raise Problem("storage.full", "there is no room for this upload", retry_after=60)
        upload = Upload(secrets.token_hex(16), owner, length, name, metadata)
        folder = self._root / upload.id
        folder.mkdir()
        (folder / "data").touch()
        write_atomically(folder / "about.json", json.dumps(asdict(upload)).encode())
        return upload

    def get(self, owner: str, upload_id: str) -> Upload:
        """The upload; raises Problem if this owner has none of that id."""
        try:
            if not UPLOAD_ID.fullmatch(upload_id):
                raise FileNotFoundError(upload_id)
            about = json.loads((self._root / upload_id / "about.json").read_bytes())
        except FileNotFoundError as error:
            raise not_found(upload_id) from error
        if about["owner"] != owner:
            raise not_found(upload_id)
        return Upload(**about)

    def offset(self, upload: Upload) -> int:
        """How many bytes have arrived."""
        return self._stat(upload).st_size

    def expires_at(self, upload: Upload) -> float:
        """When it is removed if nothing more arrives, s since 1970."""
        return self._stat(upload).st_mtime + self._seconds

    def begin(self, upload: Upload, offset: int, checksum: Checksum | None) -> Writer:
        """The right to write behind `offset`; raises Problem if that is not where it ends."""
        folder = self._root / upload.id
        try:
            data = (folder / "data").open("r+b", buffering=0)
        except FileNotFoundError as error:
            raise not_found(upload.id) from error
        try:
            fcntl.flock(data, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if (size := data.seek(0, 2)) != offset:
                raise elsewhere(size, offset)
            return FileWriter(upload, data, folder / "piece", checksum)
        except BlockingIOError as error:
            data.close()
            raise locked() from error
        except BaseException:
            data.close()
            raise

    def judge(self, upload: Upload, before: int) -> None:
        """Look at the header once it has arrived; a hopeless upload is removed, and says why.

        before: bytes that had arrived before the last piece.
        """
        path = self._root / upload.id / "data"
        enough = min(HEADER_BYTES, upload.length)
        if before >= enough or path.stat().st_size < enough:
            return
        with path.open("rb") as file:
            head = file.read(HEADER_BYTES)
        try:
            peek(head, self._limits, size=upload.length)
        except MPFError:
            self.remove(upload)
            raise

    def as_stored(self, upload: Upload, path: Path) -> Stored:
        """Give a complete upload another name, `path`, to make a job of; it stays here as well."""
        data = self._root / upload.id / "data"
        try:
            path.hardlink_to(data)
            with path.open("rb") as file:
                head = file.read(HEADER_BYTES)
                size = file.seek(0, 2)
                if size != upload.length:
                    raise incomplete(size, upload.length)
                header = peek(head, self._limits, size=size)
                file.seek(0)
                digest = hashlib.file_digest(file, "sha256").hexdigest()
        except FileNotFoundError as error:
            raise not_found(upload.id) from error
        except BaseException:
            path.unlink(missing_ok=True)
            raise
        return Stored(path, upload.name, size, digest, header)

    def remove(self, upload: Upload) -> None:
        """Forget the upload and its bytes."""
        shutil.rmtree(self._root / upload.id, ignore_errors=True)

    def remove_lapsed(self, now: float) -> Iterator[str]:
        """Remove those to which nothing came for long; their ids."""
        with suppress(FileNotFoundError):
            for folder in list(self._root.iterdir()):
                with suppress(FileNotFoundError):
                    data = folder / "data"
                    touched = (data if data.exists() else folder).stat().st_mtime
                    if now - touched > self._seconds:
                        shutil.rmtree(folder, ignore_errors=True)
                        yield folder.name

    def _stat(self, upload: Upload) -> os.stat_result:
        try:
            return (self._root / upload.id / "data").stat()
        except FileNotFoundError as error:
            raise not_found(upload.id) from error


class FileWriter(Writer):
    """Takes one piece. Without a checksum each byte counts as soon as it is written."""

    def __init__(self, upload: Upload, data: IO[bytes], piece: Path, checksum: Checksum | None):
        self._data = data
        self._piece = piece
        self._checksum = checksum
        self._room = upload.length - data.tell()
        self._target: IO[bytes] = data if checksum is None else piece.open("w+b")

    def write(self, chunk: bytes) -> None:
        """The next bytes; raises Problem if they are more than were announced."""
        self._room -= len(chunk)
        if self._room < 0:
            raise too_many()
        _write_all(self._target, chunk)

    def finish(self) -> int:
        """The piece is complete; the new offset. Raises Problem if its checksum is another."""
        if self._checksum is not None:
            self._target.seek(0)
            found = hashlib.file_digest(self._target, self._checksum.algorithm)  # type: ignore[arg-type]
            if found.digest() != self._checksum.digest:
                raise wrong_checksum()
            self._target.seek(0)
            while chunk := self._target.read(2**20):
                _write_all(self._data, chunk)
        return self._data.tell()

    def close(self) -> None:
        """Let others write; what counts has counted."""
        if self._target is not self._data:
            self._target.close()
            self._piece.unlink(missing_ok=True)
        self._data.close()


def _write_all(file: IO[bytes], data: bytes) -> None:
    """Unbuffered files may take less than they were given."""
    left = memoryview(data)
    while left:
        left = left[file.write(left) :]
