"""The loops of a fit, compiled before the first job asks for them: `python -m worker.warmup`.

They stay in the data folder, so that the next worker finds them, whatever else may be written to.
"""

from __future__ import annotations

import logging
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from service.settings import Settings

log = logging.getLogger("mpf.worker")

NICENESS = 19  # a job that comes meanwhile goes first


def cache_of_loops(settings: Settings) -> dict[str, str]:
    """Where job processes keep compiled loops, as numba's variable, unless it is set already."""
    if "NUMBA_CACHE_DIR" in os.environ:
        return {}
    return {"NUMBA_CACHE_DIR": str((settings.data_dir / "loops").resolve())}


@contextmanager
def warming(settings: Settings) -> Iterator[None]:
    """Within, a process compiles what is not in the cache yet, and ends."""
    environment = os.environ | cache_of_loops(settings) | {"MPF_PARENT_PID": str(os.getpid())}
    command = [sys.executable, "-m", "worker.warmup"]
    process = subprocess.Popen(command, env=environment, start_new_session=True)  # noqa: S603
    try:
        yield
    finally:
        process.kill()
        process.wait()


def main() -> None:
    """Compile for the precision that this processor prefers."""
    from worker.job_process import die_with_parent
    from worker.priority import yield_to_others

    die_with_parent(int(os.environ["MPF_PARENT_PID"]))
    yield_to_others(NICENESS)
    try:
        from mpf_core.compiled import prepare_loops
        from mpf_core.field.pointwise import why_plain
        from mpf_core.field.precision import products_in
    except ImportError:  # an installation without the extra `fit`, which jobs will tell
        return
    if prepare_loops(products_in("auto")).NAME == "plain":
        log.warning("fits take longer, as loops cannot be compiled: %s", why_plain())


if __name__ == "__main__":
    main()
