"""All files of a result as one ZIP, streamed: nothing is kept in memory or on disk."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO, cast

CHUNK_BYTES = 256 * 1024


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


def zip_of(files: dict[str, Path]) -> Iterator[bytes]:
    """The archive's bytes; meshes and pictures are stored as they are (GLB and PNG pack badly)."""
    pipe = _Pipe()
    with zipfile.ZipFile(cast("IO[bytes]", pipe), "w", zipfile.ZIP_STORED) as archive:
        for name, path in files.items():
            about = zipfile.ZipInfo.from_file(path, name)
            with path.open("rb") as source, archive.open(about, "w", force_zip64=True) as target:
                while chunk := source.read(CHUNK_BYTES):
                    target.write(chunk)
                    yield pipe.take()
    yield pipe.take()
