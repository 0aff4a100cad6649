"""Logs of API and worker: one line each, to standard error."""

from __future__ import annotations

import logging
import sys


def configure_logging(level: int = logging.INFO) -> None:
    """Let `mpf.*` loggers write to standard error, with time and process."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(
        logging.Formatter("%(asctime)s %(levelname)s %(name)s[%(process)d] %(message)s")
    )
    root = logging.getLogger("mpf")
    root.handlers[:] = [handler]
    root.setLevel(level)
    root.propagate = False
