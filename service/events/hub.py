"""One listener per API process: whoever waits for a job is woken when it changes.

The feed only wakes; what happened is read from the record or the stream. So a lost message costs a
little time and never an event, and any replica serves any client.
"""

from __future__ import annotations

import asyncio
import logging
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from redis.exceptions import RedisError

from service.connection import connect_async
from service.events.store import FEED_CHANNEL
from service.settings import Settings

log = logging.getLogger("mpf.api")

RECONNECT_SECONDS = 1.0


class Watcher:
    """Somebody who waits for one job."""

    def __init__(self) -> None:
        self._changed = asyncio.Event()
        self.state = ""
        """As the feed last told it; "" if the feed has said nothing yet."""

    def wake(self, state: str) -> None:
        """Something changed."""
        self.state = state
        self._changed.set()

    async def wait(self, seconds: float) -> bool:
        """Whether something changed since the last wait, or within `seconds` from now."""
        with suppress(TimeoutError):
            await asyncio.wait_for(self._changed.wait(), seconds)
        changed = self._changed.is_set()
        self._changed.clear()
        return changed


class Hub:
    """Listens as soon as the first watcher comes."""

    def __init__(self, settings: Settings):
        self._settings = settings
        self._watchers: dict[str, set[Watcher]] = defaultdict(set)
        self._task: asyncio.Task[None] | None = None

    @contextmanager
    def watching(self, job_id: str) -> Iterator[Watcher]:
        """Be woken by changes of this job inside the block."""
        if self._task is None:
            self._task = asyncio.create_task(self._listen())
        watcher = Watcher()
        self._watchers[job_id].add(watcher)
        try:
            yield watcher
        finally:
            self._watchers[job_id].discard(watcher)
            if not self._watchers[job_id]:
                del self._watchers[job_id]

    async def close(self) -> None:
        """Stop listening."""
        if self._task is not None:
            self._task.cancel()
            with suppress(asyncio.CancelledError):
                await self._task

    async def _listen(self) -> None:
        while True:
            try:
                await self._follow()
            except (RedisError, OSError) as error:
                log.warning("the feed is interrupted: %s", error)
            await asyncio.sleep(RECONNECT_SECONDS)
            self._wake_all()

    async def _follow(self) -> None:
        # A silent feed is no fault: nothing may have happened.
        redis = connect_async(self._settings, socket_timeout=None)
        async with redis, redis.pubsub() as feed:
            await feed.subscribe(FEED_CHANNEL)
            # What happened before the subscription stood must be looked for.
            self._wake_all()
            while True:
                message = await feed.get_message(ignore_subscribe_messages=True, timeout=5.0)
                if message is not None:
                    job_id, _, state = message["data"].decode().partition(" ")
                    for watcher in list(self._watchers.get(job_id, ())):
                        watcher.wake(state)

    def _wake_all(self) -> None:
        for watchers in list(self._watchers.values()):
            for watcher in list(watchers):
                watcher.wake("")
