"""The process of one job: `python -m worker.job_process`, started by a worker.

It dies with its worker, stays within its memory, and loads the numerics only in here.
"""

from __future__ import annotations

import ctypes
import os
import resource
import signal
import sys

from worker import stopping

PR_SET_PDEATHSIG = 1


def main() -> None:
    """Run the attempt that the environment names, then leave without cleaning up after torch."""
    die_with_parent(int(os.environ["MPF_PARENT_PID"]))
    # From the first moment on SIGTERM is a wish, not death; RQ installs the same again.
    signal.signal(signal.SIGTERM, stopping.hear)
    from rq.executions import Execution
    from rq.serializers import JSONSerializer

    from service.connection import connect
    from service.logs import configure_logging
    from service.settings import Settings
    from worker.memory import limit_memory
    from worker.priority import yield_to_others
    from worker.rq_job import JobProcessWorker

    settings = Settings()
    configure_logging(settings)
    limit_memory(settings)
    yield_to_others(settings.job_nice)
    redis = connect(settings)
    worker = JobProcessWorker([], os.environ["RQ_WORKER_ID"], connection=redis,
                              serializer=JSONSerializer, prepare_for_work=False)  # fmt: skip
    entry = worker.job_class.fetch(
        os.environ["RQ_JOB_ID"], connection=redis, serializer=JSONSerializer
    )
    queue = worker.queue_class(entry.origin, connection=redis, serializer=JSONSerializer)
    worker.execution = Execution.fetch(os.environ["RQ_EXECUTION_ID"], entry.id, connection=redis)
    worker.main_work_horse(entry, queue)


def die_with_parent(parent: int) -> None:
    """Have the kernel end this process when its worker ends, however that ends."""
    if sys.platform.startswith("linux"):
        ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:  # it ended before the kernel was asked
        os._exit(1)


if __name__ == "__main__":
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    main()
