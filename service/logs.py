"""Logs of API and worker: one line each, to standard error, as JSON or as text.

A message that is about a job begins with `job %s`, or is written inside `about(job_id)`: its line
then carries the id in a field of its own. What else belongs to a line is given as
`extra={"about": {...}}`.
"""

from __future__ import annotations

import json
import logging
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from datetime import UTC, datetime
from typing import Any

from service.settings import Settings

OURS = ("mpf", "uvicorn", "rq")
"""The loggers whose lines are written."""

_job: ContextVar[str] = ContextVar("mpf_job", default="")
_JOB_ID = re.compile(r"[0-9a-f]{32}")


@contextmanager
def about(job_id: str) -> Iterator[None]:
    """Lines written inside the block, by this task or thread, are about this job."""
    token = _job.set(job_id)
    try:
        yield
    finally:
        _job.reset(token)


def job_of(record: logging.LogRecord) -> str:
    """The id of the job that a line is about; "" if it is about none."""
    arguments = record.args if isinstance(record.args, tuple) else ()
    if str(record.msg).startswith("job %s") and arguments:
        return str(arguments[0])
    return _job.get()


class JsonLines(logging.Formatter):
    """One JSON object per line."""

    def format(self, record: logging.LogRecord) -> str:
        """time, level, logger, process, message; job, error and more where they are known."""
        line: dict[str, Any] = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "process": record.process,
            "message": record.getMessage(),
        }
        if job := job_of(record):
            line["job"] = job
        line |= getattr(record, "about", {})
        if record.exc_info:
            line["error"] = self.formatException(record.exc_info)
        return json.dumps(line, ensure_ascii=False, default=str)


class TextLines(logging.Formatter):
    """For people who look at a terminal."""

    def __init__(self) -> None:
        super().__init__("%(asctime)s %(levelname)s %(name)s[%(process)d] %(message)s%(suffix)s")

    def format(self, record: logging.LogRecord) -> str:
        """As JsonLines, but for the job's id where the message does not name it."""
        job = job_of(record)
        record.suffix = f" [job {job}]" if job and job not in record.getMessage() else ""
        return super().format(record)


class _Ours(logging.Filter):
    """Libraries set their loggers' levels themselves; of what they say only warnings count."""

    def filter(self, record: logging.LogRecord) -> bool:
        return record.name.startswith("mpf") or record.levelno >= logging.WARNING


def configure_logging(settings: Settings | None = None, level: int = logging.INFO) -> None:
    """Write our loggers' lines, and those of the libraries that serve, to standard error."""
    wanted = (settings or Settings()).log_format
    plain = sys.stderr.isatty() if wanted == "auto" else wanted == "text"
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(TextLines() if plain else JsonLines())
    handler.addFilter(_Ours())
    for name in OURS:
        root = logging.getLogger(name)
        root.handlers[:] = [handler]
        root.setLevel(level)
        root.propagate = False


def job_in(path: str) -> str:
    """The id of the job that a path leads to; "" if it leads to none."""
    parts = path.split("/", 3)
    if len(parts) > 2 and parts[1] == "jobs" and _JOB_ID.fullmatch(parts[2]):
        return parts[2]
    return ""
