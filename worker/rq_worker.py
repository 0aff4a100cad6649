"""RQ's worker with our own job process and our own idea of what its end means.

The job process is a fresh interpreter, not a fork: threads here cannot leave locks behind in it,
and nothing secret stands on its command line (the Redis URL is in its environment).
"""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import subprocess
import sys
from typing import Any

from redis.exceptions import RedisError
from rq import Queue, Worker
from rq.job import Job as Entry
from rq.serializers import JSONSerializer

from service.artifacts.opened import artifacts_of
from service.connection import connect
from service.jobs.lease import Lease
from service.jobs.queue import JobQueue, attempt_of, rq_name
from service.jobs.store import JobStore
from service.settings import Settings
from worker.lease import LeaseKeeper
from worker.pace import Pace
from worker.parking import Parking
from worker.settle import settle
from worker.warmup import cache_of_loops

log = logging.getLogger("mpf.worker")

# RQ blocks for this minus 15 s at a time, so a lost connection is noticed soon.
WORKER_TTL_SECONDS = 30
MONITOR_SECONDS = 30
# A job process ends itself when its time is over; one that does not hear its alarm is killed.
OVERTIME_SECONDS = 5.0


class MpfWorker(Worker):
    """One job at a time, each in a process of its own."""

    job_module = "worker.job_process"
    max_connection_wait_time = 2.0

    def __init__(self, settings: Settings):
        self.settings = settings
        redis = connect(settings)
        super().__init__(
            [
                Queue(rq_name(name), connection=redis, serializer=JSONSerializer)
                for name in settings.queues
            ],
            connection=redis,
            serializer=JSONSerializer,
            worker_ttl=WORKER_TTL_SECONDS,
            job_monitoring_interval=MONITOR_SECONDS,
            log_job_description=False,
        )
        own = connect(settings)
        self.store = JobStore(own, retention_seconds=settings.retention_seconds)
        self.queue = JobQueue(own, job_seconds=settings.job_seconds)
        self.artifacts = artifacts_of(settings)
        self.parking = Parking(self.store, self.queue, settings.running_per_owner)
        self._process: subprocess.Popen[bytes] | None = None
        self.left_on_request = False
        self.pace = Pace(settings)

    def execute_job(self, job: Entry, queue: Queue) -> None:
        """Run the entry, unless its owner runs as many jobs as it may."""
        job_id, _ = attempt_of(job.id)
        if self.parking.park(job_id):
            queue.intermediate_queue.remove(job.id)
            job.delete()
            return
        super().execute_job(job, queue)
        with contextlib.suppress(RedisError):
            self.parking.let_out()

    def fork_work_horse(self, job: Entry, queue: Queue) -> None:  # noqa: ARG002
        """Start the job process in a session of its own: it is killed and is nice as a whole."""
        environment = os.environ | {
            "RQ_WORKER_ID": self.name,
            "RQ_JOB_ID": job.id,
            "RQ_EXECUTION_ID": self.execution.id if self.execution else "",
            "MPF_PARENT_PID": str(os.getpid()),
            "OMP_NUM_THREADS": str(self.settings.threads_per_job()),
            **cache_of_loops(self.settings),
        }
        command = [sys.executable, "-m", self.job_module]
        self._process = subprocess.Popen(  # noqa: S603
            command, env=environment, start_new_session=True
        )
        self._horse_pid = self._process.pid

    def monitor_work_horse(self, job: Entry, queue: Queue, execution: Any) -> None:
        """Keep the lease while the process lives; afterwards see to it that the record moved on."""
        job_id, attempt = attempt_of(job.id)
        lease = Lease(job_id, attempt, self.name)
        keeper = LeaseKeeper(
            self.store,
            lease,
            kill=self._kill_process,
            every=self.settings.heartbeat_seconds,
            cancel_grace=self.settings.cancel_grace_seconds,
            keep_grace=self.settings.keep_grace_seconds,
            limit=self.settings.job_seconds + OVERTIME_SECONDS,
        )
        job.timeout = -1  # RQ would go by the wall clock here, which may jump
        with keeper:
            with contextlib.suppress(RedisError):
                super().monitor_work_horse(job, queue, execution)
            code = self._exit_code()
        settle(
            lease,
            code,
            self.store,
            self.queue,
            self.artifacts,
            self.settings,
            overtime=keeper.overtime,
        )
        with contextlib.suppress(RedisError):
            self.pace.note(self.store.get(job_id))

    def wait_for_horse(self) -> tuple[int | None, int | None, Any]:
        """As RQ's, but the end is noted where `subprocess` looks for it."""
        pid, status, usage = super().wait_for_horse()
        if pid and self._process is not None and status is not None:
            self._process.returncode = os.waitstatus_to_exitcode(status)
        return pid, status, usage

    def maintain_heartbeats(self, job: Entry, execution: Any) -> None:
        """RQ's own notes; their loss must not end the job."""
        with contextlib.suppress(RedisError):
            super().maintain_heartbeats(job, execution)

    def handle_warm_shutdown_request(self) -> None:
        """SIGTERM: the running job is asked to hand itself back."""
        log.info("worker %s: leaving", self.name)
        self.left_on_request = True
        if self.horse_pid:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.horse_pid, signal.SIGTERM)

    def _kill_process(self) -> None:
        if self.horse_pid:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self.horse_pid, signal.SIGKILL)

    def _exit_code(self) -> int:
        """How the process ended; waits for it if RQ has given up watching."""
        process = self._process
        assert process is not None
        return process.wait()
