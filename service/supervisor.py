"""Keeps a set of processes alive until told to stop: `mpf serve` is this and nothing else."""

from __future__ import annotations

import contextlib
import ctypes
import logging
import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import FrameType

log = logging.getLogger("mpf.serve")

FIRST_BACKOFF, LONGEST_BACKOFF = 0.5, 30.0
HEALTHY_SECONDS = 30.0
"""A child that lived this long starts anew with the first backoff."""

TICK_SECONDS = 0.1

_PR_SET_PDEATHSIG = 1
_libc = ctypes.CDLL(None) if sys.platform.startswith("linux") else None


@dataclass
class Child:
    """One process that should be there."""

    name: str
    command: Sequence[str]
    environment: Mapping[str, str] = field(default_factory=dict)
    pass_fds: tuple[int, ...] = ()
    stop_seconds: float = 10.0
    """How long it may take to end by itself."""

    process: subprocess.Popen[bytes] | None = None
    backoff: float = FIRST_BACKOFF
    started_at: float = 0.0
    start_at: float = 0.0

    def start(self) -> None:
        """Start it in a session of its own, so that Ctrl-C reaches only the supervisor."""
        self.process = subprocess.Popen(  # noqa: S603
            list(self.command),
            env=os.environ | dict(self.environment),
            pass_fds=self.pass_fds,
            start_new_session=True,
            preexec_fn=_die_with_parent,  # noqa: PLW1509  the supervisor has one thread
        )
        self.started_at = time.monotonic()

    def running(self) -> bool:
        """Whether it is there."""
        return self.process is not None and self.process.poll() is None

    def terminate(self) -> None:
        """Ask it to end."""
        if self.process is not None and self.running():
            self.process.terminate()

    def finish(self, deadline: float) -> None:
        """Wait until it has ended; at the deadline end it with all it started."""
        if self.process is None:
            return
        try:
            self.process.wait(max(0.0, deadline - time.monotonic()))
        except subprocess.TimeoutExpired:
            log.warning("%s does not end; killed", self.name)
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self.process.pid, signal.SIGKILL)
            self.process.wait()


class Supervisor:
    """Starts children in order, restarts the dead, stops all in reverse order.

    Must run in the main thread of a process with no other: it forks, and children are told to end
    with the thread that started them.
    """

    def __init__(self) -> None:
        self._stop = False
        self._waves: list[list[Child]] = []

    def listen(self) -> None:
        """Take SIGINT, SIGTERM and SIGHUP as the wish to stop."""
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, self._request_stop)

    @property
    def stopping(self) -> bool:
        """Whether a stop was asked for."""
        return self._stop

    def add(self, *children: Child) -> None:
        """Start these together; later waves are stopped before earlier ones."""
        for child in children:
            child.start()
        self._waves.append(list(children))

    def tick(self) -> None:
        """One look at all of them."""
        for wave in self._waves:
            for child in wave:
                self._mind(child)

    def run(self) -> None:
        """Until a stop is asked for."""
        while not self._stop:
            self.tick()
            time.sleep(TICK_SECONDS)

    def stop(self) -> None:
        """End all children; the first wave, on which the others depend, last."""
        for wave in reversed(self._waves):
            for child in wave:
                child.terminate()
            now = time.monotonic()
            for child in wave:
                child.finish(now + child.stop_seconds)

    def _mind(self, child: Child) -> None:
        now = time.monotonic()
        if child.running():
            if now - child.started_at > HEALTHY_SECONDS:
                child.backoff = FIRST_BACKOFF
            return
        if child.process is not None:
            log.warning("%s ended with %s; again in %.1f s", child.name,
                        child.process.returncode, child.backoff)  # fmt: skip
            child.process = None
            child.start_at = now + child.backoff
            child.backoff = min(child.backoff * 2, LONGEST_BACKOFF)
        elif now >= child.start_at:
            child.start()

    def _request_stop(self, _signal: int, _frame: FrameType | None) -> None:
        self._stop = True


def _die_with_parent() -> None:
    """In the child, before it becomes the command: end with the supervisor, however it ends."""
    if _libc is not None:
        _libc.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
