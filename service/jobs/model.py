"""The job as a value, and the only table of its states.

queued ──► running ──► succeeded ─┐
  ▲  │        │  ├───► failed ────┼──► expired
  │  │        │  └───► cancelled ─┘
  │  └────────┼──────► cancelled
  └───────────┘  handed back, reaped, or its tiles are fitted: the attempt number grows by one

A fit whose cloud was split into tiles is `running` without a lease while they are fitted.
"""

from __future__ import annotations

import json
import secrets
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from enum import StrEnum
from typing import Any


class JobState(StrEnum):
    """Where a job is in its life."""

    QUEUED = "queued"
    RUNNING = "running"
    SUCCEEDED = "succeeded"
    FAILED = "failed"
    CANCELLED = "cancelled"
    EXPIRED = "expired"


TRANSITIONS: Mapping[JobState, frozenset[JobState]] = {
    # A queued job fails only when its attempts are used up.
    JobState.QUEUED: frozenset({JobState.RUNNING, JobState.CANCELLED, JobState.FAILED}),
    JobState.RUNNING: frozenset(
        {JobState.SUCCEEDED, JobState.FAILED, JobState.CANCELLED, JobState.QUEUED}
    ),
    JobState.SUCCEEDED: frozenset({JobState.EXPIRED}),
    JobState.FAILED: frozenset({JobState.EXPIRED}),
    JobState.CANCELLED: frozenset({JobState.EXPIRED}),
    JobState.EXPIRED: frozenset(),
}

RESULTS = frozenset({JobState.SUCCEEDED, JobState.FAILED, JobState.CANCELLED})
"""How a job can end; from then on it waits to expire."""

ENDED = RESULTS | {JobState.EXPIRED}


def origins(target: JobState) -> frozenset[JobState]:
    """The states from which `target` may be entered."""
    return frozenset(state for state, nexts in TRANSITIONS.items() if target in nexts)


FIT = "fit"
EXTRACTION = "extraction"
"""A mesh or slices from the field of a job before it, which is this job's input."""
TILE = "tile"
"""The fit of one part of a large cloud: a child of the job on that cloud, shown only as a part of
it, and gone once that has ended."""


@dataclass(frozen=True)
class Artifact:
    """One published file."""

    bytes: int
    sha256: str


@dataclass(frozen=True)
class Preview:
    """The latest mesh of an unfinished fit; `number` counts those of its attempt from 1."""

    attempt: int
    number: int
    bytes: int
    sha256: str


@dataclass(frozen=True)
class Input:
    """What was uploaded."""

    name: str
    format: str
    bytes: int
    sha256: str
    points: int | None = None
    """As the header or the content check counted them."""


@dataclass(frozen=True)
class Tiles:
    """How many parts the cloud of a fit was split into, are fitted, and are being fitted."""

    total: int
    done: int = 0
    running: int = 0


@dataclass(frozen=True)
class JobProgress:
    """The last report of a running job; times in seconds."""

    stage: str
    fraction: float
    seconds: float
    eta: float | None = None
    iteration: int | None = None
    iterations: int | None = None
    loss: float | None = None
    losses: Mapping[str, float] = field(default_factory=dict)
    points_per_second: float | None = None


@dataclass(frozen=True)
class Job:
    """One record. Times are milliseconds since 1970 by the clock of Redis."""

    id: str
    state: JobState
    attempt: int
    kind: str = FIT
    """FIT, EXTRACTION or TILE: what its worker does."""
    parent: str = ""
    split: int = 0
    """The attempt that split its cloud, whose files are the tiles; 0: none has. The next attempt
    joins their fields."""
    tiles: Tiles | None = None
    splitting: bool = False
    """Whether a worker has begun to split its cloud."""
    queue: str = ""
    """Where it waits, by the weight of its work."""
    owner: str = ""
    """Whose it is: the id of an API key, or "" where none is needed."""
    label: str = ""
    """A word of the caller's, to find the job by."""
    options: Mapping[str, Any] = field(default_factory=dict)
    input: Input | None = None
    progress: JobProgress | None = None
    preview: Preview | None = None
    """Of the attempt that it names; older ones are gone."""
    problem: Mapping[str, Any] | None = None
    artifacts: Mapping[str, Artifact] = field(default_factory=dict)
    """Files of the result, by their names relative to it."""
    result_attempt: int = 0
    """The attempt whose files are the result; 0 while there is none."""
    lease: str = ""
    """Who runs it; empty unless running."""
    beats: int = 0
    """Renewals of the lease. It is the moving of this number, not a clock, that keeps a lease."""
    cancel: str = ""
    """What a caller asked for: "" (nothing), "discard", or "keep" (the surface so far)."""
    webhook: Mapping[str, Any] | None = None
    """Whom to tell of changes; holds a secret, so it is never shown."""
    created_at: int = 0
    updated_at: int = 0
    queued_at: int = 0
    started_at: int | None = None
    finished_at: int | None = None
    expires_at: int = 0

    @property
    def shown(self) -> Preview | None:
        """The preview, while it is one of what runs now."""
        current = self.preview is not None and self.preview.attempt == self.attempt
        return self.preview if current and self.state is JobState.RUNNING else None

    @property
    def tries(self) -> int:
        """Attempts at what is to be done now: splitting does not count against joining."""
        return self.attempt - self.split

    @property
    def in_tiles(self) -> bool:
        """Whether it waits for its tiles, and no worker has it."""
        return self.state is JobState.RUNNING and self.split == self.attempt

    @property
    def given_up(self) -> bool:
        """Whether it is not tried again once its worker is lost.

        In tiles there is no surface so far without each of them and the join: what is to be kept
        there is tried again, and takes its time.
        """
        in_parts = self.kind == TILE or self.splitting or self.split > 0
        return bool(self.cancel) and not (in_parts and self.cancel == "keep")

    @property
    def ended(self) -> bool:
        """Whether nothing will change any more (but expiry)."""
        return self.state in ENDED


def new_job_id() -> str:
    """An id that nobody can guess."""
    return secrets.token_hex(16)


_JSON_FIELDS = {
    "options", "webhook", "input", "progress", "preview", "problem", "artifacts", "tiles",
    "splitting",
}  # fmt: skip
_INT_FIELDS = {
    "attempt", "split", "result_attempt", "beats", "created_at", "updated_at", "queued_at",
    "started_at", "finished_at", "expires_at",
}  # fmt: skip


def job_from_record(record: Mapping[str, str]) -> Job:
    """The job that a Redis hash holds; fields of later versions are ignored."""
    known = {f.name for f in fields(Job)}
    values: dict[str, Any] = {}
    for name, text in record.items():
        if name in known:
            values[name] = _parsed(name, text)
    values["state"] = JobState(values["state"])
    if values.get("input"):
        values["input"] = Input(**values["input"])
    if values.get("progress"):
        values["progress"] = JobProgress(**values["progress"])
    if values.get("preview"):
        values["preview"] = Preview(**values["preview"])
    if values.get("tiles"):
        values["tiles"] = Tiles(**values["tiles"])
    files = values.get("artifacts") or {}
    values["artifacts"] = {name: Artifact(**about) for name, about in files.items()}
    return Job(**values)


def _parsed(name: str, text: str) -> Any:
    if name in _JSON_FIELDS:
        return json.loads(text)
    return int(text) if name in _INT_FIELDS else text


def as_field(value: Any) -> str:
    """A value as a Redis hash holds it."""
    if isinstance(value, str):
        return value
    if isinstance(value, int) and not isinstance(value, bool):
        return str(value)
    return json.dumps(value, allow_nan=False)
