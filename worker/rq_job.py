"""RQ's half inside the job process."""

from __future__ import annotations

import signal

from rq import Worker

from worker import stopping


class JobProcessWorker(Worker):
    """Performs one entry; SIGTERM asks the job to hand itself back instead of killing it."""

    def setup_work_horse_signals(self) -> None:
        """Ctrl-C is the parent's business."""
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, stopping.hear)
