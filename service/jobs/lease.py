"""The right to write one attempt of one job, and what a change of the record answers."""

from __future__ import annotations

from dataclasses import dataclass

from service.jobs.model import JobState


@dataclass(frozen=True)
class Lease:
    """The right to write one attempt of one job."""

    job_id: str
    attempt: int
    holder: str

    def token(self) -> str:
        """What the record holds while this lease is valid."""
        return f"{self.attempt}:{self.holder}"


class Refused(Exception):
    """The record is not what the change expects: gone, in another state, or another's.

    reason: missing, fenced, illegal, waiting (others of its owner run), cancelled;
        of a creation: exists, full, repeated, conflict
    job_id: of a creation that was repeated or conflicts, the job that is there already
    """

    def __init__(self, reason: str, state: JobState | None = None, job_id: str = ""):
        super().__init__(f"{reason} ({state or job_id})")
        self.reason = reason
        self.state = state
        self.job_id = job_id


@dataclass(frozen=True)
class Changed:
    """The record right after a change."""

    state: JobState
    attempt: int
    cancel: str
