"""A worker: takes jobs from the queue one by one, and looks after jobs that others lost."""

from __future__ import annotations

import logging
import signal
import threading
from collections.abc import Callable
from types import FrameType

from redis.exceptions import RedisError

from service.connection import connect, require_noeviction
from service.logs import configure_logging
from service.operations.store import WorkerRegister
from service.settings import Settings
from worker.housekeeping import Housekeeping
from worker.rq_worker import MpfWorker
from worker.settle import out_of_memory_killed

log = logging.getLogger("mpf.worker")

FIRST_WAIT_SECONDS, LONGEST_WAIT_SECONDS = 0.2, 5.0


class Stop:
    """Whether this process was told to end while no worker was there to hear it."""

    def __init__(self) -> None:
        self.requested = threading.Event()

    def listen(self) -> None:
        """Take SIGINT and SIGTERM; RQ's own handlers replace these while it works."""
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._hear)

    def _hear(self, _signal: int, _frame: FrameType | None) -> None:
        self.requested.set()


def run_worker(settings: Settings, make: Callable[[Settings], MpfWorker] = MpfWorker) -> None:
    """Work until told to stop; a Redis that is away is waited for."""
    configure_logging(settings)
    out_of_memory_killed()  # the count from here on
    stop = Stop()
    wait = FIRST_WAIT_SECONDS
    while not stop.requested.is_set():
        stop.listen()
        try:
            require_noeviction(connect(settings))
            worker = make(settings)
            if _work(worker, settings):
                return
            wait = FIRST_WAIT_SECONDS
        except RedisError as error:
            log.warning("no work without Redis (%s): %s", settings.redis_safe_url(), error)
        if stop.requested.wait(wait):
            return
        wait = min(wait * 2, LONGEST_WAIT_SECONDS)


def _work(worker: MpfWorker, settings: Settings) -> bool:
    """Take jobs until told to leave (True) or until the connection is lost for good (False)."""
    try:
        with Housekeeping(worker.name, worker.pace, settings):
            worker.work(logging_level="WARNING")
        WorkerRegister(connect(settings)).leave(worker.name)
    except RedisError as error:
        log.warning("worker %s: %s", worker.name, error)
    return worker.left_on_request
