"""A job's share of the memory."""

from __future__ import annotations

import os
import resource
from pathlib import Path

from service.settings import Settings

SHARE = 0.8
_CGROUP_LIMIT = Path("/sys/fs/cgroup/memory.max")


def limit_memory(settings: Settings) -> None:
    """Make allocations beyond the limit fail in this process, before the kernel kills at random.

    RLIMIT_DATA counts private writable memory; RLIMIT_AS would count libraries and reservations.
    """
    limit = memory_per_job(settings)
    if limit > 0:
        resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))


def memory_per_job(settings: Settings) -> int:
    """Bytes that one job process may use; 0: no limit."""
    if settings.job_memory_bytes is not None:
        return settings.job_memory_bytes
    return int(SHARE * machine_memory() / settings.workers)


def machine_memory() -> int:
    """Bytes of RAM, or of the container's share of it."""
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    try:
        return min(total, int(_CGROUP_LIMIT.read_text()))
    except (OSError, ValueError):
        return total


def is_out_of_memory(error: BaseException) -> bool:
    """Whether `error` says that an allocation failed; torch says so in a RuntimeError."""
    text = str(error)
    return isinstance(error, MemoryError) or (
        isinstance(error, RuntimeError)
        and ("can't allocate memory" in text or "not enough memory" in text or "bad_alloc" in text)
    )
