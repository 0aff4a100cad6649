"""Reading records for the many who poll: without a thread each, and with one question for all.

Polls come by the hundred while fits hold the cores. Handing each to a thread costs two more turns
at a busy processor than asking from the event loop; and who asks while a question is on its way
shares the next one.
"""

from __future__ import annotations

import asyncio
from contextlib import suppress

from redis.asyncio import Redis

from service.connection import connect_async
from service.jobs.index_store import QUESTIONS, Looked, ask, looked
from service.settings import Settings


class Polls:
    """For one event loop; connects when it is first asked."""

    def __init__(self, settings: Settings):
        self._settings = settings
        self._redis: Redis | None = None
        self._asked: dict[str, asyncio.Future[Looked]] = {}
        self._task: asyncio.Task[None] | None = None

    async def look(self, job_id: str) -> Looked:
        """The job and how many queued jobs are before it; raises RedisError."""
        answer = self._asked.get(job_id)
        if answer is None:
            answer = self._asked[job_id] = asyncio.get_running_loop().create_future()
        if self._task is None or self._task.done():
            self._task = asyncio.create_task(self._serve())
        # One who gives up must not take the answer from the others.
        return await asyncio.shield(answer)

    async def close(self) -> None:
        """Hang up."""
        if self._task is not None:
            self._task.cancel()
            with suppress(asyncio.CancelledError):
                await self._task
        if self._redis is not None:
            await self._redis.aclose()

    async def _serve(self) -> None:
        while self._asked:
            asked, self._asked = self._asked, {}
            try:
                found = await self._ask(list(asked))
            except Exception as error:
                for answer in asked.values():
                    answer.set_exception(error)
                    answer.exception()  # looked at, should nobody wait any more
            else:
                for job_id, answer in asked.items():
                    answer.set_result(found[job_id])

    async def _ask(self, job_ids: list[str]) -> dict[str, Looked]:
        if self._redis is None:
            self._redis = connect_async(self._settings)
        async with self._redis.pipeline(transaction=False) as pipeline:
            for job_id in job_ids:
                ask(pipeline, job_id)
            replies = await pipeline.execute()
        answers = (replies[at : at + QUESTIONS] for at in range(0, len(replies), QUESTIONS))
        return {job_id: looked(*told) for job_id, told in zip(job_ids, answers, strict=True)}
