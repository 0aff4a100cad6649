"""The content of an input, read before the 202 by a process that may fail alone.

The parent starts `python -m service.uploads.check`, which reads the cloud under limits on memory
and time and prints one JSON line. No verdict in time, or none at all, accepts the input: the job
reads it again and ends as `failed` with the same code if it must.
"""

from __future__ import annotations

import json
import logging
import resource
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

from service.problems import Problem, catalogue
from service.settings import Settings
from service.uploads.sink import Stored

log = logging.getLogger("mpf.api")

MEMORY_BYTES = 4 * 2**30

# Two at a time: the cores belong to the fits.
_turn = threading.BoundedSemaphore(2)


def check_content(stored: Stored, settings: Settings) -> int | None:
    """Points of the input, or None where that stays open; raises Problem for a hopeless one."""
    declared = stored.header.points
    if stored.bytes > settings.content_check_bytes:
        return declared
    with _turn:
        verdict = _ask(stored.path, settings.max_points, settings.content_check_seconds)
    if verdict is None:
        return declared
    if "code" in verdict:
        raise _problem(verdict)
    return int(verdict["points"])


def _ask(path: Path, max_points: int, seconds: float) -> dict[str, Any] | None:
    command = [sys.executable, "-m", "service.uploads.check", str(path), str(max_points)]
    try:
        done = subprocess.run(  # noqa: S603  our own module, a path we chose
            command, capture_output=True, timeout=seconds, check=False, stdin=subprocess.DEVNULL
        )
        verdict = json.loads(done.stdout)
    except (subprocess.TimeoutExpired, ValueError) as error:
        log.warning("content check without verdict: %s", type(error).__name__)
        return None
    return verdict if isinstance(verdict, dict) else None


def _problem(verdict: dict[str, Any]) -> Problem:
    code = verdict["code"] if verdict["code"] in catalogue() else "input"
    return Problem(code, verdict["message"], where=verdict["where"], advice=verdict["advice"])


def main(path: str, max_points: str) -> None:
    """In the child: read, judge, print."""
    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY_BYTES, MEMORY_BYTES))
    from mpf_core.errors import InputError
    from service.uploads.header import require_usable

    try:
        verdict: dict[str, Any] = {"points": require_usable(Path(path), int(max_points))}
    except InputError as error:
        verdict = dict(error.as_dict())
    sys.stdout.write(json.dumps(verdict))


if __name__ == "__main__":
    main(*sys.argv[1:3])
