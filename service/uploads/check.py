"""The content of an input, read by a process that may fail alone.

The parent starts `python -m service.uploads.check`, which reads the cloud under limits on memory
and time and prints one JSON line. POST /jobs asks for a `verdict` before the 202; none in time, or
none at all, accepts the input: the job reads it again and ends as `failed` with the same code if it
must. POST /inspect asks for all that the reader found.
"""

from __future__ import annotations

import json
import logging
import os
import resource
import subprocess
import sys
import threading
from pathlib import Path, PurePosixPath
from typing import Any

from service.problems import Problem, catalogue
from service.settings import Settings
from service.uploads.sink import Stored

log = logging.getLogger("mpf.api")

MEMORY_BYTES = 4 * 2**30
NICENESS = 5  # whoever polls goes first, whoever fits comes later

# Two at a time: the cores belong to the fits.
_turn = threading.BoundedSemaphore(2)


def check_content(stored: Stored, settings: Settings) -> int | None:
    """Points of the input, or None where that stays open; raises Problem for a hopeless one."""
    declared = stored.header.points
    if stored.bytes > settings.content_check_bytes:
        return declared
    with _turn:
        verdict = _ask("verdict", stored, settings, settings.content_check_seconds)
    return declared if verdict is None else int(verdict["points"])


def inspect_content(stored: Stored, settings: Settings) -> dict[str, Any]:
    """`Inspection.as_dict()` of the input; raises Problem where there is none."""
    with _turn:
        found = _ask("inspection", stored, settings, settings.inspect_seconds)
    if found is None:
        raise Problem(
            "input.not_inspected",
            f"the inspection did not end within {settings.inspect_seconds:g} s and its memory",
            advice="Use `mpf inspect` on a machine of your own, or submit the input as a job.",
        )
    return found | {"file": PurePosixPath(stored.name.replace("\\", "/")).name}


def _ask(what: str, stored: Stored, settings: Settings, seconds: float) -> dict[str, Any] | None:
    """The answer to "verdict" or "inspection", None without one; raises what the reader says."""
    limits = [str(settings.max_points), str(settings.upload_bytes)]
    command = [sys.executable, "-m", "service.uploads.check", what, str(stored.path)]
    command += limits
    try:
        done = subprocess.run(  # noqa: S603  our own module, a path we chose
            command, capture_output=True, timeout=seconds, check=False, stdin=subprocess.DEVNULL
        )
        answer = json.loads(done.stdout)
    except (subprocess.TimeoutExpired, ValueError) as error:
        log.warning("content check without %s: %s", what, type(error).__name__)
        return None
    if not isinstance(answer, dict):
        return None
    if "code" in answer:
        raise _problem(answer)
    return answer


def _problem(verdict: dict[str, Any]) -> Problem:
    code = verdict["code"] if verdict["code"] in catalogue() else "input"
    return Problem(code, verdict["message"], where=verdict["where"], advice=verdict["advice"])


def main(what: str, path: str, max_points: str, max_bytes: str) -> None:
    """In the child: read, judge, print."""
    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY_BYTES, MEMORY_BYTES))
    os.nice(NICENESS)
    from mpf_core.cloud.inspection import inspect_cloud
    from mpf_core.cloud.limits import Limits
    from mpf_core.errors import InputError
    from service.uploads.header import require_usable

    answer: dict[str, Any]
    try:
        if what == "inspection":
            limits = Limits(max_bytes=int(max_bytes), max_points=int(max_points))
            answer = inspect_cloud(path, limits=limits).as_dict()
        else:
            answer = {"points": require_usable(Path(path), int(max_points))}
    except InputError as error:
        answer = dict(error.as_dict())
    sys.stdout.write(json.dumps(answer))


if __name__ == "__main__":
    main(*sys.argv[1:5])
