"""Uploads in pieces over an object store, so that any replica of the API takes the next one.

    resumable/{id}/about.json        whose it is, how long it will be, its name; written once
    resumable/{id}/part-{offset}     some of its bytes, from that offset on

The offset is where the parts without a gap end, and stands nowhere else. One writer at a time, by a
lock in Redis; parts are never replaced, so that one who lost the lock unawares spoils nothing.
"""

from __future__ import annotations

import hashlib
import json
import secrets
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import IO

from mpf_core.cloud.limits import Limits
from mpf_core.errors import MPFError
from service.artifacts.base import StoreUnavailable
from service.artifacts.bucket import AlreadyThere, Bucket, Entry
from service.connection import RedisError
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
from service.uploads.lock_store import UploadLocks
from service.uploads.sink import Stored

PART_BYTES = 4 * 2**20
"""What is lost at most when a process dies within a piece."""

RENEW_SECONDS = 10.0


class ObjectUploads(Resumable):
    """The uploads of a bucket."""

    def __init__(self, bucket: Bucket, locks: UploadLocks, settings: Settings):
        self._bucket = bucket
        self._locks = locks
        self._limits = Limits(max_bytes=settings.upload_bytes, max_points=settings.max_points)
        self._seconds = settings.resumable_seconds
        self._scratch = settings.data_dir / "uploads"

    def prepare(self) -> None:
        """Nothing but a piece that waits for its checksum is kept on this machine."""

    def create(self, owner: str, length: int, name: str, metadata: str) -> Upload:
        """Begin an upload of `length` bytes."""
        upload = Upload(secrets.token_hex(16), owner, length, name, metadata)
        self._bucket.put(f"{_folder(upload.id)}/about.json", json.dumps(asdict(upload)).encode())
        return upload

    def get(self, owner: str, upload_id: str) -> Upload:
        """The upload; raises Problem if this owner has none of that id."""
        try:
            if not UPLOAD_ID.fullmatch(upload_id):
                raise FileNotFoundError(upload_id)
            about = json.loads(self._bucket.get(f"{_folder(upload_id)}/about.json"))
        except FileNotFoundError as error:
            raise not_found(upload_id) from error
        if about["owner"] != owner:
            raise not_found(upload_id)
        return Upload(**about)

    def offset(self, upload: Upload) -> int:
        """How many bytes have arrived."""
        return _end(self._parts(upload))

    def expires_at(self, upload: Upload) -> float:
        """When it is removed if nothing more arrives."""
        _, objects = self._bucket.children(_folder(upload.id))
        if not objects:
            raise not_found(upload.id)
        return max(entry.modified for entry in objects) + self._seconds

    def begin(self, upload: Upload, offset: int, checksum: Checksum | None) -> Writer:
        """The right to write behind `offset`; raises Problem if that is not where it ends."""
        token = self._locks.take(upload.id)
        if token is None:
            raise locked()
        try:
            if (size := self.offset(upload)) != offset:
                raise elsewhere(size, offset)
            whole = self._scratch_file() if checksum else None
            return PartWriter(self._bucket, self._locks, upload, token, offset, checksum, whole)
        except BaseException:
            self._locks.free(upload.id, token)
            raise

    def judge(self, upload: Upload, before: int) -> None:
        """Look at the header once it has arrived; a hopeless upload is removed, and says why."""
        enough = min(HEADER_BYTES, upload.length)
        if before >= enough:
            return
        parts = self._parts(upload)
        if _end(parts) < enough:
            return
        try:
            peek(self._head(parts), self._limits, size=upload.length)
        except MPFError:
            self.remove(upload)
            raise

    def as_stored(self, upload: Upload, path: Path) -> Stored:
        """Fetch a complete upload to the file `path`."""
        parts = self._parts(upload)
        if (size := _end(parts)) != upload.length:
            raise incomplete(size, upload.length)
        digest = hashlib.sha256()
        try:
            header = peek(self._head(parts), self._limits, size=size)
            with path.open("xb") as file:
                for part in parts:
                    for piece in self._bucket.read(part.key, 0, part.size):
                        digest.update(piece)
                        file.write(piece)
        except BaseException as error:
            path.unlink(missing_ok=True)
            if isinstance(error, FileNotFoundError):
                raise not_found(upload.id) from error
            raise
        return Stored(path, upload.name, size, digest.hexdigest(), header)

    def remove(self, upload: Upload) -> None:
        """Forget the upload and its bytes; should that fail, it lapses."""
        with suppress(StoreUnavailable):
            self._remove(upload.id)

    def remove_lapsed(self, now: float) -> Iterator[str]:
        """Remove those to which nothing came for long; their ids."""
        for upload_id in self._bucket.children("resumable")[0]:
            _, objects = self._bucket.children(_folder(upload_id))
            if objects and now - max(entry.modified for entry in objects) > self._seconds:
                self._remove(upload_id)
                yield upload_id

    def _scratch_file(self) -> IO[bytes]:
        return tempfile.TemporaryFile(dir=self._scratch)

    def _remove(self, upload_id: str) -> None:
        self._bucket.delete([entry.key for entry in self._bucket.below(_folder(upload_id))])

    def _parts(self, upload: Upload) -> list[Entry]:
        """Those without a gap, in order."""
        _, objects = self._bucket.children(_folder(upload.id))
        found = {_offset_in(entry): entry for entry in objects if "/part-" in entry.key}
        parts, end = [], 0
        while end in found:
            parts.append(found[end])
            end += found[end].size
        return parts

    def _head(self, parts: list[Entry]) -> bytes:
        head = b""
        for part in parts:
            if len(head) >= HEADER_BYTES:
                break
            head += b"".join(self._bucket.read(part.key, 0, min(part.size, HEADER_BYTES)))
        return head[:HEADER_BYTES]


class PartWriter(Writer):
    """Gathers what comes into parts. Without a checksum each part counts once it is written."""

    def __init__(
        self,
        bucket: Bucket,
        locks: UploadLocks,
        upload: Upload,
        token: str,
        offset: int,
        checksum: Checksum | None,
        whole: IO[bytes] | None,
    ):
        self._bucket = bucket
        self._locks = locks
        self._upload = upload
        self._token = token
        self._offset = offset
        self._checksum = checksum
        self._room = upload.length - offset
        self._gathered = bytearray()
        self._renewed_at = time.monotonic()
        self._whole = whole
        self._lost = False

    def write(self, chunk: bytes) -> None:
        """The next bytes."""
        self._room -= len(chunk)
        if self._room < 0:
            raise too_many()
        self._keep_lock()
        if self._whole is not None:
            self._whole.write(chunk)
            return
        self._gather(chunk)

    def finish(self) -> int:
        """The piece is complete; the new offset."""
        if self._whole is not None and self._checksum is not None:
            self._whole.seek(0)
            found = hashlib.file_digest(self._whole, self._checksum.algorithm)  # type: ignore[arg-type]
            if found.digest() != self._checksum.digest:
                raise wrong_checksum()
            self._whole.seek(0)
            while chunk := self._whole.read(PART_BYTES):
                self._gather(chunk)
        self._put()
        return self._offset

    def close(self) -> None:
        """Keep what has come, where it counts without the rest, and let others write."""
        try:
            if self._whole is not None:
                self._whole.close()
            elif not self._lost:
                self._put()
        finally:
            with suppress(RedisError):  # it lapses
                self._locks.free(self._upload.id, self._token)

    def _gather(self, chunk: bytes) -> None:
        self._gathered += chunk
        if len(self._gathered) >= PART_BYTES:
            self._put()

    def _put(self) -> None:
        if not self._gathered:
            return
        data, self._gathered = bytes(self._gathered), bytearray()
        self._keep_lock(at_once=True)
        try:
            self._bucket.put(f"{_folder(self._upload.id)}/part-{self._offset:016d}", data, new=True)
        except AlreadyThere as error:
            self._lost = True
            raise locked() from error
        self._offset += len(data)

    def _keep_lock(self, *, at_once: bool = False) -> None:
        now = time.monotonic()
        if not at_once and now - self._renewed_at < RENEW_SECONDS:
            return
        self._renewed_at = now
        if not self._locks.renew(self._upload.id, self._token):
            self._lost = True
            self._gathered.clear()
            raise locked()


def _folder(upload_id: str) -> str:
    return f"resumable/{upload_id}"


def _offset_in(entry: Entry) -> int:
    return int(entry.key.rpartition("-")[2])


def _end(parts: list[Entry]) -> int:
    return sum(part.size for part in parts)
