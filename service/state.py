"""What a process of the service holds while it runs, and how endpoints come by it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from fastapi import Depends, Request
from redis import Redis

from service.access.store import KeyStore, RateLimit, ShareStore
from service.artifacts.base import Artifacts
from service.artifacts.opened import artifacts_of
from service.connection import connect
from service.events.hub import Hub
from service.events.store import EventStore
from service.jobs.commands import JobCommands
from service.jobs.polls import Polls
from service.jobs.queue import JobQueue
from service.jobs.tile_store import TileStore
from service.operations.estimates import Estimates
from service.operations.health import Health
from service.operations.metrics import Metrics
from service.operations.store import FitRate, WorkerRegister
from service.settings import Settings
from service.uploads.incoming import Resumable
from service.uploads.intake import Intake
from service.uploads.opened import uploads_of
from service.uploads.receive import Receiver
from service.webhooks.store import WebhookStore


@dataclass(frozen=True)
class State:
    """The parts, made once per process."""

    settings: Settings
    redis: Redis
    artifacts: Artifacts
    store: TileStore
    events: EventStore
    webhooks: WebhookStore
    hub: Hub
    polls: Polls
    jobs: JobCommands
    receiver: Receiver
    resumable: Resumable
    intake: Intake
    estimates: Estimates
    health: Health
    metrics: Metrics
    keys: KeyStore
    shares: ShareStore
    rates: RateLimit
    rate: FitRate


def build_state(settings: Settings) -> State:
    """Wire the parts; nothing connects before it is used."""
    redis = connect(settings)
    artifacts = artifacts_of(settings)
    store = TileStore(
        redis,
        retention_seconds=settings.retention_seconds,
        progress_seconds=settings.progress_seconds,
    )
    queue = JobQueue(redis, job_seconds=settings.job_seconds)
    resumable = uploads_of(settings, redis)
    commands = JobCommands(redis, store, queue, artifacts, settings)
    return State(
        settings=settings,
        redis=redis,
        artifacts=artifacts,
        store=store,
        events=EventStore(redis),
        webhooks=WebhookStore(redis),
        hub=Hub(settings),
        polls=Polls(settings),
        jobs=commands,
        receiver=Receiver(artifacts, settings),
        resumable=resumable,
        intake=Intake(commands, artifacts, resumable, settings),
        estimates=Estimates(store, WorkerRegister(redis), settings),
        health=Health(redis, artifacts),
        metrics=Metrics(store, WorkerRegister(redis), artifacts),
        keys=KeyStore(redis),
        shares=ShareStore(redis),
        rates=RateLimit(redis, settings.requests_per_minute, settings.requests_burst),
        rate=FitRate(redis),
    )


async def state_of(request: Request) -> State:
    """The state of the application that serves `request`."""
    state: State = request.app.state.mpf
    return state


StateDep = Annotated[State, Depends(state_of)]
