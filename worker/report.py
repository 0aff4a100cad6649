"""What the running job tells its record, and what the record tells it: both rationed."""

from __future__ import annotations

import logging
import math
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from mpf_core.progress import Progress
from service.connection import UNREACHABLE
from service.jobs.lease import Lease, Refused
from service.jobs.model import JobProgress
from service.jobs.store import JobStore
from service.settings import Settings
from worker import stopping

log = logging.getLogger("mpf.worker")

Clock = Callable[[], float]


@dataclass(frozen=True)
class Part:
    """What an attempt does of its job: from which share of it to which, and who else is to hear."""

    begins: float = 0.0
    ends: float = 1.0
    told: Callable[[], None] = lambda: None


WHOLE = Part()


class Reporter:
    """The `progress`, `stop` and `cancel` callbacks of one attempt.

    `reason` says why the job was told to stop: "cancelled", "hand back" or "fenced" (the lease is
    another's; whatever this process still does is lost), and `cancel` is true from then on. `stop`
    is true once the owner cancelled but wants to keep the surface so far: only the fit ends.
    """

    def __init__(
        self,
        store: JobStore,
        lease: Lease,
        settings: Settings,
        part: Part = WHOLE,
        clock: Clock = time.monotonic,
    ):
        self._part = part
        self._store = store
        self._lease = lease
        self._settings = settings
        self._clock = clock
        self._told_at = -math.inf
        self._told_stage = ""
        self._asked_at = -math.inf
        self.reason = ""
        self._keep = False
        self._rates: list[float] = []

    def progress(self, progress: Progress) -> None:
        """Note the report, if enough time has passed or the stage has changed."""
        now = self._clock()
        if (
            now - self._told_at < self._settings.progress_seconds
            and progress.stage == self._told_stage
        ):
            return
        self._told_at, self._told_stage = now, progress.stage
        if progress.points_per_second is not None:
            self._rates.append(progress.points_per_second)
        try:
            told = _plain(progress)
            fraction = self._part.begins + told.fraction * (self._part.ends - self._part.begins)
            changed = self._store.progress(self._lease, replace(told, fraction=fraction))
            self._heed(changed.cancel)
            self._part.told()
        except Refused as refusal:
            self._stop("fenced", str(refusal))
        except UNREACHABLE as error:
            log.warning("job %s: progress not noted: %s", self._lease.job_id, error)

    def points_per_second(self) -> float | None:
        """At which the fit went, by the median of what it reported; None if it did not."""
        return statistics.median(self._rates) if self._rates else None

    def cancel(self) -> bool:
        """Whether the job should stop; asks the record a few times a second at most."""
        if self.reason:
            return True
        if stopping.hand_back_requested():
            self._stop("hand back", "the worker is leaving")
            return True
        self._ask()
        return bool(self.reason)

    def stop(self) -> bool:
        """Whether the fit should end with what it has; rationed as `cancel` is."""
        self._ask()
        return self._keep

    def _ask(self) -> None:
        now = self._clock()
        if now - self._asked_at < self._settings.cancel_poll_seconds:
            return
        self._asked_at = now
        try:
            valid, cancel = self._store.heed(self._lease)
        except UNREACHABLE as error:
            log.warning("job %s: cannot ask for cancellation: %s", self._lease.job_id, error)
            return
        if not valid:
            self._stop("fenced", "the lease is lost")
        else:
            self._heed(cancel)

    def _heed(self, cancel: str) -> None:
        if cancel == "keep":
            self._keep = True
        elif cancel:
            self._stop("cancelled", cancel)

    def _stop(self, reason: str, why: str) -> None:
        if not self.reason:
            log.info("job %s: stopping, %s (%s)", self._lease.job_id, reason, why)
            self.reason = reason


def _plain(progress: Progress) -> JobProgress:
    """The report as JSON can carry it: no NaN, no infinity."""
    return JobProgress(
        stage=progress.stage,
        fraction=min(1.0, max(0.0, _finite(progress.fraction) or 0.0)),
        seconds=_finite(progress.seconds) or 0.0,
        eta=_finite(progress.eta),
        iteration=progress.iteration,
        iterations=progress.iterations,
        loss=_finite(progress.loss),
        losses={n: float(v) for n, v in progress.losses.items() if math.isfinite(v)},
        points_per_second=_finite(progress.points_per_second),
    )


def _finite(value: float | None) -> float | None:
    return float(value) if value is not None and math.isfinite(value) else None
