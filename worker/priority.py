"""How much a job process yields to everything else on the machine."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

AUTOGROUP = Path("/proc/self/autogroup")


def yield_to_others(niceness: int) -> None:
    """Let every other process go first; to be called in a session of this process's own.

    Linux may share the processor among sessions first (`kernel.sched_autogroup_enabled`). Then a
    niceness holds within a session only, and it is the session's own that counts towards others:
    without it, a nice job of many threads weighs as much as the API.
    """
    os.nice(niceness)
    # Elsewhere, or without autogroups, there is nothing to be said. Nor in a session that others
    # share: they would be slowed as well.
    if niceness and os.getsid(0) == os.getpid():
        with suppress(OSError):
            AUTOGROUP.write_text(str(niceness))
