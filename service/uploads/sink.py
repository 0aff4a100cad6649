"""The bytes of one input on their way to disk: counted, hashed and judged as they pass."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import BinaryIO

from mpf_core.cloud.limits import Limits
from service.problems import Problem
from service.uploads.header import HEADER_BYTES, Header, peek


@dataclass(frozen=True)
class Stored:
    """A body that is on disk as a whole."""

    path: Path
    name: str
    bytes: int
    sha256: str
    header: Header


class UploadSink:
    """Writes to `path`; leaves nothing behind unless `finish` was reached.

    The header is judged as soon as its bytes are there, so that a hopeless file is refused before
    the rest of it has travelled.
    """

    def __init__(self, path: Path, name: str, *, limits: Limits):
        self._path = path
        self._name = name
        self._limits = limits
        self._size = 0
        self._hash = hashlib.sha256()
        self._head = b""
        self._file: BinaryIO | None = None
        self._finished = False

    def __enter__(self) -> UploadSink:
        self._file = self._path.open("xb")
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._file is not None:
            self._file.close()
        if not self._finished:
            self._path.unlink(missing_ok=True)

    def write(self, data: bytes) -> None:
        """Take the next bytes; raises Problem or MPFError as soon as the input is hopeless."""
        assert self._file is not None
        self._size += len(data)
        if self._size > self._limits.max_bytes:
            raise too_large(self._limits.max_bytes)
        if len(self._head) < HEADER_BYTES:
            self._head += data[: HEADER_BYTES - len(self._head)]
            if len(self._head) == HEADER_BYTES:
                peek(self._head, self._limits, size=None)
        self._hash.update(data)
        self._file.write(data)

    def finish(self) -> Stored:
        """The body is complete."""
        assert self._file is not None
        header = peek(self._head, self._limits, size=self._size)
        self._file.flush()
        self._finished = True
        return Stored(self._path, self._name, self._size, self._hash.hexdigest(), header)


def too_large(limit: int) -> Problem:
    """The problem of an input over the limit of bytes."""
    return Problem(
        "request.too_large",
        f"the input has more than {limit} bytes",
        where="file",
        advice="Thin the cloud out, or ask the operator for a higher MPF_UPLOAD_BYTES.",
    )
