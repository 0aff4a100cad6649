"""What a store of artefacts offers, wherever its bytes lie: each file is whole or not there.

Attempts never share a file, so that a worker that lost its lease can spoil nothing. Which result
counts is said by the record.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path

from service.jobs.model import Artifact

CHUNK_BYTES = 256 * 1024


class StoreUnavailable(OSError):
    """The store does not answer, or refuses us; str() says what it told."""


class NoSuchStore(Exception):
    """MPF_STORE_URL names no store; str() says why."""


@dataclass(frozen=True)
class Published:
    """What an attempt at a job has published."""

    job_id: str
    attempt: int


class Blob(ABC):
    """One stored file. `name` without folders, `size` in bytes, `modified` in s since 1970."""

    name: str
    size: int
    modified: float

    @property
    def path(self) -> Path | None:
        """Where it lies on this machine, if it does."""
        return None

    @abstractmethod
    def read(self, start: int = 0, end: int | None = None) -> Iterator[bytes]:
        """Its bytes from `start` to before `end`, in pieces."""

    def link(self) -> str | None:
        """A URL at which whoever has it may read the file for a while, if the store makes such."""
        return None


class Artifacts(ABC):
    """The files of all jobs. Raises StoreUnavailable, and OSError for the disk of this machine."""

    look_seconds = 0.0
    """Shortest time between two looks through all of it, by whichever worker."""

    @abstractmethod
    def prepare(self) -> None:
        """Make the folders of this machine; raises OSError if that cannot be done."""

    @abstractmethod
    def check_writable(self) -> None:
        """Write and remove a small file; raises OSError if the store does not take it."""

    @abstractmethod
    def free_fraction(self) -> float:
        """Share of the store that is free; 1 where nobody can tell."""

    # Inputs

    @abstractmethod
    def new_upload(self) -> Path:
        """A path on this machine for a body on its way in."""

    @abstractmethod
    def adopt_input(self, job_id: str, upload: Path, format_: str) -> None:
        """Make a complete upload the input of a job; on return it is durable."""

    @abstractmethod
    def share_input(self, parent: str, job_id: str) -> None:
        """Give a job the input of another one; raises FileNotFoundError if there is none."""

    @abstractmethod
    def share_field(self, parent: str, attempt: int, name: str, job_id: str) -> None:
        """Make a file of another job's result the input of a job, as `share_input` does."""

    @abstractmethod
    def input(self, job_id: str, attempt: int) -> Path:
        """The input as a file on this machine, for this attempt; raises FileNotFoundError."""

    @abstractmethod
    def given(self, job_id: str) -> Blob:
        """The input where it lies, named `input.{format}`; raises FileNotFoundError."""

    # Results

    @abstractmethod
    def work(self, job_id: str, attempt: int) -> Path:
        """An empty folder on this machine for an attempt to write into."""

    @abstractmethod
    def publish(self, job_id: str, attempt: int) -> dict[str, Artifact]:
        """Make what the attempt wrote its result, at once and durably; its files by name.

        May be called again after StoreUnavailable.
        """

    @abstractmethod
    def result(self, job_id: str, attempt: int, name: str) -> Blob:
        """The file of a published result; raises FileNotFoundError if it has none of that name."""

    @abstractmethod
    def local_result(
        self, source: Published, job_id: str, attempt: int, *, but: str | None = None
    ) -> Path:
        """A folder of this machine with all files of a published result, for an attempt (at
        whichever job) to read; raises FileNotFoundError.

        but: files whose names begin so may be missing
        """

    @abstractmethod
    def forget_results(self, job_id: str, *, but: int) -> None:
        """Remove what attempts have published, except that of attempt `but`."""

    @abstractmethod
    def write_preview(self, job_id: str, attempt: int, glb: bytes) -> None:
        """Put the latest mesh of an unfinished fit in place of the one before."""

    @abstractmethod
    def read_preview(self, job_id: str, attempt: int) -> bytes:
        """That mesh; raises FileNotFoundError if there is none."""

    @abstractmethod
    def checkpoint(
        self, job_id: str, attempt: int, *, inherit: bool = True
    ) -> AbstractContextManager[Path]:
        """Where an attempt keeps the state of its fit; at first that of the attempt before.

        Attempts share no file: one that lost its lease and does not know it yet spoils nothing.
        What was written there when the block ends is kept for the next attempt, whichever machine
        that runs on.
        """

    @abstractmethod
    def forget_checkpoints(self, job_id: str) -> None:
        """The job has ended: nobody will go on from where it was."""

    @abstractmethod
    def discard_work(self, job_id: str, attempt: int) -> None:
        """Remove what an attempt wrote without publishing it."""

    # Removal

    @abstractmethod
    def remove(self, job_id: str) -> None:
        """Remove all files of a job."""

    @abstractmethod
    def job_ids(self) -> Iterator[str]:
        """The jobs that have files."""

    @abstractmethod
    def age(self, job_id: str, now: float) -> float:
        """Seconds since a file of the job was last written; raises FileNotFoundError."""

    @abstractmethod
    def remove_leftovers(self, older_than: float) -> Iterator[str]:
        """Remove what was left on this machine by dead processes; the names.

        older_than: s since 1970; what was touched since then stays.
        """
