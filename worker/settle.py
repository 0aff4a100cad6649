"""After a job process: a record that is still `running` under its lease has lost its process."""

from __future__ import annotations

import logging
import signal
from pathlib import Path

from redis.exceptions import RedisError

from service.artifacts.base import Artifacts, StoreUnavailable
from service.jobs.family import cancelled_problem
from service.jobs.lease import Lease, Refused
from service.jobs.model import Job, JobState
from service.jobs.queue import JobQueue
from service.jobs.store import JobStore
from service.problems import Problem
from service.settings import Settings

log = logging.getLogger("mpf.worker")


def settle(
    lease: Lease,
    code: int,
    store: JobStore,
    queue: JobQueue,
    artifacts: Artifacts,
    settings: Settings,
    *,
    overtime: bool = False,
) -> None:
    """Fail, cancel or requeue what a dead job process left; the reaper does so if Redis is away.

    overtime: it was killed since its time was over.
    """
    try:
        job = store.get(lease.job_id)
        if job is not None and job.state is JobState.RUNNING and job.lease == lease.token():
            log.warning("job %s: its process ended with %s", job.id, code)
            if overtime and not job.given_up:
                store.fail(lease, time_limit_problem(settings))
            else:
                _end_of(job, lease, code, store, queue, settings)
            forget_if_ended(job.id, store, artifacts)
        elif job is not None and job.state is JobState.QUEUED and code == -signal.SIGTERM:
            # It was told to leave before it had started.
            queue.enqueue(job, job.attempt)
        if code != 0:  # else it has done so itself
            artifacts.discard_work(lease.job_id, lease.attempt)
    except Refused as refusal:
        log.info("job %s: settled elsewhere (%s)", lease.job_id, refusal)
    except RedisError as error:
        log.warning("job %s: left to the reaper: %s", lease.job_id, error)
    except StoreUnavailable as error:
        log.warning("job %s: left to the removal of the job: %s", lease.job_id, error)


def forget_if_ended(job_id: str, store: JobStore, artifacts: Artifacts) -> None:
    """Remove what the next attempt would go on from, if there is none."""
    job = store.get(job_id)
    if job is None or job.ended:
        artifacts.forget_checkpoints(job_id)


def _end_of(
    job: Job, lease: Lease, code: int, store: JobStore, queue: JobQueue, settings: Settings
) -> None:
    if job.given_up:
        store.cancelled(lease, cancelled_problem())
    elif code == -signal.SIGKILL and out_of_memory_killed():
        store.fail(lease, out_of_memory_problem())
    elif job.tries >= settings.max_attempts:
        store.fail(lease, crashed_problem(job.tries))
    else:
        changed = store.hand_back(lease)
        queue.enqueue(job, changed.attempt)


def out_of_memory_killed(events: Path = Path("/sys/fs/cgroup/memory.events")) -> bool:
    """Whether the kernel has killed for memory in this container since this was last asked.

    A plain SIGKILL says nothing of its reason; without the counter it counts as a crash.
    """
    try:
        words = dict(line.split() for line in events.read_text().splitlines())
        kills = int(words.get("oom_kill", 0))
    except (OSError, ValueError):
        return False
    before = _kills_seen.get(events, kills)
    _kills_seen[events] = kills
    return kills > before


_kills_seen: dict[Path, int] = {}


def crashed_problem(attempts: int) -> dict[str, object]:
    """Why a job is not tried again."""
    detail = f"the job's process died in each of {attempts} attempts"
    return Problem("job.crashed", detail, advice="See the worker's log.").as_dict()


def time_limit_problem(settings: Settings) -> dict[str, object]:
    """Why a job that took too long is not tried again."""
    limit = f"an attempt may take {settings.job_seconds:g} s"
    return Problem(
        "job.time_limit", limit, advice="Lower time_budget, or thin the cloud out."
    ).as_dict()


def out_of_memory_problem() -> dict[str, object]:
    """Why a job that was too large is not tried again."""
    return Problem(
        "job.out_of_memory",
        "the job was stopped for lack of memory",
        advice="Lower the resolution or thin the cloud out.",
    ).as_dict()
