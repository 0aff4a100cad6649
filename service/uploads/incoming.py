"""What an upload in pieces is, wherever its bytes are kept."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from service.problems import Problem
from service.uploads.sink import Stored

UPLOAD_ID = re.compile(r"[0-9a-f]{32}")


@dataclass(frozen=True)
class Upload:
    """One upload on its way in; `metadata` as the client wrote it, `name` that of its file."""

    id: str
    owner: str
    length: int
    name: str
    metadata: str


@dataclass(frozen=True)
class Checksum:
    """algorithm: a name that hashlib knows; digest: what the piece must come to."""

    algorithm: str
    digest: bytes


class Writer(ABC):
    """Takes one piece."""

    @abstractmethod
    def write(self, chunk: bytes) -> None:
        """The next bytes; raises Problem if they are more than were announced."""

    @abstractmethod
    def finish(self) -> int:
        """The piece is complete; the new offset. Raises Problem if its checksum is another."""

    @abstractmethod
    def close(self) -> None:
        """Let others write; what counts has counted."""


class Resumable(ABC):
    """The uploads in pieces. Another's upload is as good as none."""

    @abstractmethod
    def prepare(self) -> None:
        """Make the folders of this machine; raises OSError if that cannot be done."""

    @abstractmethod
    def create(self, owner: str, length: int, name: str, metadata: str) -> Upload:
        """Begin an upload of `length` bytes; raises Problem where there is no room for it."""

    @abstractmethod
    def get(self, owner: str, upload_id: str) -> Upload:
        """The upload; raises Problem if this owner has none of that id."""

    @abstractmethod
    def offset(self, upload: Upload) -> int:
        """How many bytes have arrived."""

    @abstractmethod
    def expires_at(self, upload: Upload) -> float:
        """When it is removed if nothing more arrives, s since 1970."""

    @abstractmethod
    def begin(self, upload: Upload, offset: int, checksum: Checksum | None) -> Writer:
        """The right to write behind `offset`; raises Problem if that is not where it ends."""

    @abstractmethod
    def judge(self, upload: Upload, before: int) -> None:
        """Look at the header once it has arrived; a hopeless upload is removed, and says why.

        before: bytes that had arrived before the last piece.
        """

    @abstractmethod
    def as_stored(self, upload: Upload, path: Path) -> Stored:
        """Make a file `path` of a complete upload, to make a job of; it stays here as well."""

    @abstractmethod
    def remove(self, upload: Upload) -> None:
        """Forget the upload and its bytes."""

    @abstractmethod
    def remove_lapsed(self, now: float) -> Iterator[str]:
        """Remove those to which nothing came for long; their ids."""


def not_found(upload_id: str) -> Problem:
    """The problem of an upload that is nobody's, or another's, or has lapsed."""
    return Problem("upload.not_found", f"there is no upload {upload_id[:64]}")


def elsewhere(size: int, offset: int) -> Problem:
    """The problem of a piece that does not begin where the upload ends."""
    return Problem(
        "upload.offset", f"the upload has {size} bytes, not {offset}",
        where="Upload-Offset", advice="Ask by HEAD where it ends.",
    )  # fmt: skip


def locked() -> Problem:
    """The problem of a piece while another one is on its way."""
    return Problem("upload.locked", "another request is writing to this upload", retry_after=1)


def too_many() -> Problem:
    """The problem of bytes behind the announced end."""
    return Problem("request.too_large", "there are more bytes than Upload-Length announced")


def wrong_checksum() -> Problem:
    """The problem of a piece that was spoiled on its way."""
    return Problem(
        "upload.checksum", "the piece is not what its checksum says",
        where="Upload-Checksum", advice="Send it again.",
    )  # fmt: skip


def incomplete(size: int, length: int) -> Problem:
    """The problem of a job that is to be made of half an upload."""
    return Problem(
        "upload.incomplete", f"{size} of {length} bytes have arrived",
        where="upload", advice="Send the rest first.",
    )  # fmt: skip
