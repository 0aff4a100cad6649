"""The parent's side of a running job: it renews the lease, and ends a process that lost it."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable

from service.connection import UNREACHABLE
from service.jobs.lease import Lease
from service.jobs.store import JobStore

log = logging.getLogger("mpf.worker")


class LeaseKeeper:
    """Renews one lease from a thread while the job process lives.

    The parent does this, not the job process: a long call into native code must not look like
    death. `kill` is called once, when the lease is lost, a job that is given up outstays its grace,
    or the process lives longer than `limit` seconds by the steady clock: then `overtime` is true.
    """

    def __init__(
        self,
        store: JobStore,
        lease: Lease,
        *,
        kill: Callable[[], None],
        every: float,
        cancel_grace: float,
        keep_grace: float,
        limit: float,
    ):
        self.overtime = False
        self._limit = limit
        self._begin = time.monotonic()
        self._store = store
        self._lease = lease
        self._kill = kill
        self._every = every
        self._grace = {"discard": cancel_grace, "keep": keep_grace}
        self._pause = every
        self._cancelled_since: float | None = None
        self._started = False
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._keep, name="lease", daemon=True)

    def __enter__(self) -> LeaseKeeper:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join(timeout=self._every + 10)

    def _keep(self) -> None:
        while not self._over.wait(self._pause):
            if time.monotonic() - self._begin > self._limit:
                log.warning("job %s: its process outlives its time", self._lease.job_id)
                self.overtime = True
                self._kill()
                return
            try:
                must_die = self._must_die(*self._store.renew(self._lease))
            except UNREACHABLE as error:
                log.warning("job %s: cannot renew its lease: %s", self._lease.job_id, error)
                continue
            if must_die:
                self._kill()
                return

    def _must_die(self, valid: bool, cancel: str) -> bool:
        self._started = self._started or valid
        if not valid:
            # Before the process has taken the lease there is nothing to lose.
            if self._started:
                log.warning("job %s: the lease is lost", self._lease.job_id)
            return self._started
        if not cancel:
            return False
        grace = self._grace[cancel]
        self._pause = min(self._every, grace)
        self._cancelled_since = self._cancelled_since or time.monotonic()
        if time.monotonic() - self._cancelled_since < grace:
            return False
        job = self._store.get(self._lease.job_id)
        return job is None or job.given_up
