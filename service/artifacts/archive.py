"""All files of a result as one ZIP, streamed: nothing is kept in memory or on disk."""

from __future__ import annotations

import time
import zipfile
from collections.abc import Iterable, Iterator
from typing import IO, cast

from service.artifacts.base import Blob


class _Pipe:
    """What the archive writes, until it is taken."""

    def __init__(self) -> None:
        self._chunks: list[bytes] = []

    def write(self, data: bytes) -> int:
        self._chunks.append(bytes(data))
        return len(data)

    def flush(self) -> None:
        """Nothing is held back."""

    def take(self) -> bytes:
        taken = b"".join(self._chunks)
        self._chunks.clear()
        return taken


def zip_of(files: Iterable[tuple[str, Blob]]) -> Iterator[bytes]:
    """The archive's bytes; meshes and pictures are stored as they are (GLB and PNG pack badly)."""
    pipe = _Pipe()
    with zipfile.ZipFile(cast("IO[bytes]", pipe), "w", zipfile.ZIP_STORED) as archive:
        for name, blob in files:
            about = zipfile.ZipInfo(name, time.localtime(blob.modified)[:6])
            about.file_size = blob.size
            about.external_attr = 0o100644 << 16
            with archive.open(about, "w", force_zip64=True) as target:
                for chunk in blob.read():
                    target.write(chunk)
                    yield pipe.take()
    yield pipe.take()
