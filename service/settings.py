"""Every knob of the service and the worker, with its unit; read from `MPF_…` in the environment."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Literal

from pydantic import Field
from pydantic_settings import BaseSettings, SettingsConfigDict

from mpf_core.options import MOST_TILES

MEBIBYTE = 2**20

QueueName = Literal["extract", "fit-small", "fit-large"]
EXTRACT: QueueName = "extract"
FIT_SMALL: QueueName = "fit-small"
FIT_LARGE: QueueName = "fit-large"
QUEUES: tuple[QueueName, ...] = (EXTRACT, FIT_SMALL, FIT_LARGE)
"""Queues by the weight of what waits in them, in the order in which a worker looks at them."""


class Settings(BaseSettings):
    """One value, made once at the start of a process and handed to what needs it."""

    model_config = SettingsConfigDict(env_prefix="MPF_", frozen=True)

    # What is written down
    log_format: Literal["auto", "json", "text"] = Field(
        default="auto", description="Lines of the logs; auto: text on a terminal, else JSON."
    )

    # Where things are
    redis_url: str = Field(
        default="redis://127.0.0.1:6379/0",
        description="Record store and queue: Valkey 7.2+ or Redis 6.2+.",
    )
    data_dir: Path = Field(
        default=Path("mpf-data"),
        description="Folder of the artefact store (and of the embedded Valkey).",
    )

    store_url: str | None = Field(
        default=None,
        description="Inputs and results in an object store: s3://bucket/prefix, gs://, az://; "
        "then data_dir holds only what passes through this machine.",
    )
    store_link_seconds: float = Field(
        default=900.0,
        ge=0,
        le=7 * 86_400,
        description="For which a link to a file in the object store is good, s; 0: the API passes "
        "all files on itself.",
    )
    store_link_endpoint: str = Field(
        default="",
        description="The object store's address as callers reach it, if it is another than ours.",
    )

    # What is accepted
    upload_bytes: int = Field(default=1024 * MEBIBYTE, ge=1, description="Largest input, bytes.")
    max_points: int = Field(default=10_000_000, ge=51, description="Most points in an input.")
    resumable_seconds: float = Field(
        default=86_400.0,
        gt=0,
        description="Time for which an interrupted upload may be taken up again, s.",
    )
    body_bytes: int = Field(
        default=1 * MEBIBYTE, ge=1, description="Largest request body that is not an upload, bytes."
    )
    content_check_bytes: int = Field(
        default=32 * MEBIBYTE,
        ge=0,
        description="Inputs up to this size are read before the 202, bytes.",
    )
    content_check_seconds: float = Field(
        default=20.0,
        gt=0,
        description="Longest such check; an input that takes longer is accepted, s.",
    )
    inspect_seconds: float = Field(
        default=60.0, gt=0, description="Longest inspection of an input by POST /inspect, s."
    )
    queue_length: int = Field(
        default=1000, ge=1, description="Queued jobs above which POST answers 503."
    )

    # Who may ask
    require_keys: bool = Field(
        default=False, description="Ask every caller for an API key; set beyond loopback."
    )
    allowed_hosts: tuple[str, ...] = Field(
        default=(), description="Names under which the service may be reached without keys."
    )
    cors_origins: tuple[str, ...] = Field(
        default=(), description="Origins whose pages may use the service from a browser."
    )
    requests_per_minute: int = Field(
        default=0, ge=0, description="Requests of one caller per minute; 0: no limit."
    )
    requests_burst: int = Field(default=60, ge=1, description="Of these, at once.")
    jobs_per_owner: int = Field(
        default=0, ge=0, description="Queued and running jobs of one caller; 0: no limit."
    )
    running_per_owner: int = Field(
        default=0,
        ge=0,
        description="Jobs of one caller that run at the same time; the others wait. 0: no limit.",
    )

    tiles_per_job: int = Field(
        default=64,
        ge=1,
        le=MOST_TILES,
        description="Tiles of one cloud; what asks for more is refused. The default has room for "
        "25 million points at the default of 400,000 a tile.",
    )

    # How a job runs
    threads: int | None = Field(
        default=None, ge=1, description="CPU threads of one fit; cores // workers if not given."
    )
    workers: int = Field(default=1, ge=1, description="Workers that share this machine's cores.")
    worker_index: int = Field(
        default=0, ge=0, description="Which of these this is, from 0: who gets an odd core."
    )
    queues: tuple[QueueName, ...] = Field(
        default=QUEUES,
        min_length=1,
        description="Queues that a worker takes jobs from, the first ones first.",
    )
    large_fit_evaluations: int = Field(
        default=50_000_000,
        ge=0,
        description="Points of a step times the cap on steps above which a fit is large "
        "(draft: 2 million, balanced: 6 million, paper: 450 million).",
    )
    large_fit_points: int = Field(
        default=1_000_000, ge=0, description="Points of a cloud above which its fit is large."
    )
    job_seconds: float = Field(
        default=7 * 86_400.0, gt=0, description="Wall-clock limit of one attempt at a job, s."
    )
    job_memory_bytes: int | None = Field(
        default=None,
        ge=0,
        description="Memory of one job process; 0: no limit; 80 % of RAM if not given.",
    )
    job_nice: int = Field(
        default=10, ge=0, le=19, description="Niceness of job processes: the API goes first."
    )
    max_attempts: int = Field(
        default=5, ge=1, description="Attempts at one job, crashes and lost workers counted."
    )
    progress_seconds: float = Field(
        default=0.5,
        ge=0,
        description="Shortest time between two progress reports in the record, s.",
    )
    cancel_poll_seconds: float = Field(
        default=0.25, gt=0, description="How often a fit asks whether it was cancelled, s."
    )
    cancel_grace_seconds: float = Field(
        default=0.7,
        gt=0,
        description="Time a cancelled job has to end by itself before it is "
        "killed; there is nothing of it to save, s.",
    )
    keep_grace_seconds: float = Field(
        default=300.0,
        gt=0,
        description="The same where the surface so far is wanted, s; a cloud in tiles has no "
        "surface before all of them have ended, and takes its time.",
    )
    heartbeat_seconds: float = Field(
        default=1.0, gt=0, description="How often a worker renews the lease on its job, s."
    )
    lease_seconds: float = Field(
        default=20.0, gt=0, description="A lease not renewed for this long is taken away, s."
    )
    redis_patience_seconds: float = Field(
        default=600.0, ge=0, description="How long a job process waits for Redis to come back, s."
    )

    pulse_file: Path | None = Field(
        default=None,
        description="A file that a worker touches every few seconds while it lives, for health "
        "checks; whether Redis answers makes no difference.",
    )

    # Webhooks
    webhook_networks: tuple[str, ...] = Field(
        default=(), description="Networks with private addresses that may get webhooks, as CIDR."
    )
    webhook_pause_factor: float = Field(
        default=1.0, gt=0, description="Stretches the pauses between tries (5 s to 14 h)."
    )

    # How long things stay
    retention_seconds: float = Field(
        default=7 * 86_400.0, gt=0, description="Time for which an ended job keeps its files, s."
    )
    tombstone_seconds: float = Field(
        default=30 * 86_400.0, ge=0, description="Time for which an expired job is answered 410, s."
    )
    disk_low_fraction: float = Field(
        default=0.05,
        ge=0,
        lt=1,
        description="Free share of the disk below which ended jobs expire early and POST answers "
        "507.",
    )
    retention_round_seconds: float = Field(
        default=30.0, gt=0, description="Time between two looks at what has expired, s."
    )
    orphan_seconds: float = Field(
        default=3600.0, gt=0, description="Age at which files that belong to no job are removed, s."
    )

    def redis_safe_url(self) -> str:
        """The URL without its password, for logs and messages."""
        head, _, _ = self.redis_url.partition("?")
        scheme, found, rest = head.partition("://")
        return f"{scheme}://{rest.rpartition('@')[2]}" if found else head

    def threads_per_job(self) -> int:
        """CPU threads of one fit: what was asked for, or a share of the cores.

        The shares of all workers of this machine sum to its cores, unless there are fewer cores.
        """
        cores, place = usable_cores(), self.worker_index % self.workers
        share = cores * (place + 1) // self.workers - cores * place // self.workers
        return self.threads or max(1, share)


def usable_cores(quota: Path = Path("/sys/fs/cgroup/cpu.max")) -> int:
    """Cores this process may run on (affinity masks, cpusets and a container's quota counted)."""
    if hasattr(os, "sched_getaffinity"):
        cores = len(os.sched_getaffinity(0))
    else:
        cores = os.cpu_count() or 1
    try:
        share, period = quota.read_text().split()
        return max(1, min(cores, int(share) // int(period)))
    except (OSError, ValueError):  # no container, or "max"
        return cores
