"""GET /jobs/{id}/events: server-sent events, resumable at any replica."""

from __future__ import annotations

import json
import re
import time
from collections.abc import AsyncIterator
from typing import Annotated, Any

from anyio import to_thread
from fastapi import APIRouter, Header
from fastapi.responses import StreamingResponse

from service.access.dependency import CallerDep
from service.events.store import Event
from service.jobs.model import Job
from service.jobs.routes import JobId
from service.jobs.schemas import job_out
from service.problems import Problem
from service.responses import problems
from service.state import State, StateDep

router = APIRouter(tags=["events"])

PING_SECONDS = 15.0
RETRY_MILLISECONDS = 2000
_EVENT: dict[str, Any] = {
    "type": "object",
    "description": "One event; its data is JSON.",
    "required": ["id", "event", "data"],
    "properties": {
        "id": {"type": "string", "pattern": r"^\d+-\d+$"},
        "event": {"enum": ["job", "state", "progress", "preview", "cancel"]},
        "data": {"type": "string", "contentMediaType": "application/json"},
    },
}
_EVENT_ID = re.compile(r"\d{1,20}-\d{1,20}")


class EventStream(StreamingResponse):
    """text/event-stream."""

    media_type = "text/event-stream"


@router.get(
    "/jobs/{job_id}/events",
    response_class=EventStream,
    responses=problems("job.not_found", "job.expired", "request.invalid")
    | {200: {"content": {EventStream.media_type: {"schema": _EVENT}}}},
)
async def events(
    job_id: JobId,
    caller: CallerDep,
    state: StateDep,
    last_event_id: Annotated[str, Header(description="Continue behind this event.")] = "",
) -> EventStream:
    """What happens to the job, until it has ended: `job`, `state`, `progress`, `preview`."""
    if last_event_id and not _EVENT_ID.fullmatch(last_event_id):
        raise Problem("request.invalid", "this is no id of an event", where="Last-Event-ID")
    await to_thread.run_sync(state.jobs.get, caller, job_id)
    return EventStream(
        _follow(state, job_id, last_event_id),
        headers={"Cache-Control": "no-store", "X-Accel-Buffering": "no"},
    )


async def _follow(state: State, job_id: str, last: str) -> AsyncIterator[str]:
    yield f"retry: {RETRY_MILLISECONDS}\n\n"
    with state.hub.watching(job_id) as watcher:
        if not last or not await to_thread.run_sync(state.events.reaches_back_to, job_id, last):
            last = await to_thread.run_sync(state.events.last_id, job_id)
            job = await to_thread.run_sync(state.store.get, job_id)
            if job is None:
                return
            yield _written(Event(last, "job", _snapshot(job)))
        spoke_at = time.monotonic()
        while True:
            # The record is read first: if it has ended, its last event is in the stream already.
            job = await to_thread.run_sync(state.store.get, job_id)
            for event in await to_thread.run_sync(state.events.after, job_id, last):
                last, spoke_at = event.id, time.monotonic()
                yield _written(event)
            if job is None or job.ended:
                return
            if time.monotonic() - spoke_at > PING_SECONDS:
                spoke_at = time.monotonic()
                yield ": ping\n\n"
            await watcher.wait(PING_SECONDS)


def _snapshot(job: Job) -> dict[str, Any]:
    return job_out(job).model_dump(mode="json")


def _written(event: Event) -> str:
    data = json.dumps(event.data, separators=(",", ":"))
    return f"id: {event.id}\nevent: {event.name}\ndata: {data}\n\n"
