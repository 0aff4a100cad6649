"""The acts run: blocking, and asynchronous."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping, Sequence
from os import PathLike
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

import httpx2

from service.client.acts import Acts, Looked, Moved, silent
from service.client.steps import Ask, Pause, Steps, Unreachable, with_key
from service.jobs.schemas import JobOut

T = TypeVar("T")

PATIENCE_SECONDS = 60.0


class _Connection:
    """What both clients are made of: where the service is, and who asks."""

    def __init__(self, server: str, key: str | None, patience: float):
        self._server = server.rstrip("/")
        self._key = key
        self._acts = Acts(patience)

    def _arguments(self, ask: Ask) -> dict[str, Any]:
        ask = with_key(ask, self._key)
        return {
            "method": ask.method,
            "url": self._server + ask.path,
            "params": dict(ask.params) or None,
            "headers": dict(ask.headers),
            "json": ask.json,
            "content": ask.content,
            "timeout": ask.timeout,
        }

    def _unreachable(self, error: Exception) -> Unreachable:
        return Unreachable(f"{self._server} does not answer: {error or type(error).__name__}")


class Client(_Connection):
    """server: where the service is, http://host:port; key: an API key, where one is needed;
    patience: how long a service that is away is asked again, s.

    Methods raise Refused for problems and Unreachable.
    """

    def __init__(self, server: str, key: str | None = None, *, patience: float = PATIENCE_SECONDS):
        super().__init__(server, key, patience)
        # The key must not travel to where a redirect leads; httpx2 drops it for other origins.
        self._http = httpx2.Client(follow_redirects=True)

    def __enter__(self) -> Client:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Hang up."""
        self._http.close()

    def submit(
        self,
        cloud: str | PathLike[str],
        options: Mapping[str, Any] | None = None,
        *,
        label: str = "",
        upload: str | None = None,
        moved: Moved = silent,
        began: Callable[[str], None] = silent,
    ) -> JobOut:
        """Send a cloud, in pieces that resume, and queue its reconstruction (`Acts.submit`)."""
        return self._run(
            self._acts.submit(
                Path(cloud), options, label=label, upload=upload, moved=moved, began=began
            )
        )

    def job(self, job_id: str, wait: float = 0.0) -> JobOut:
        """The job as it stands, or as soon as its state is another, within `wait` seconds."""
        return self._run(self._acts.job(job_id, wait))

    def jobs(
        self, *, states: Sequence[str] = (), label: str | None = None, limit: int = 50
    ) -> list[JobOut]:
        """One's jobs, newest first."""
        return self._run(self._acts.jobs(states=states, label=label, limit=limit))

    def wait(self, job_id: str, looked: Looked = silent) -> JobOut:
        """The job once it has ended; `looked` is told of it every two seconds."""
        return self._run(self._acts.wait(job_id, looked))

    def cancel(self, job_id: str, *, keep: bool = False) -> JobOut:
        """Ask the job to stop; keep: have the surface so far as its result."""
        return self._run(self._acts.cancel(job_id, keep=keep))

    def delete(self, job_id: str) -> None:
        """Remove the job and its files."""
        self._run(self._acts.delete(job_id))

    def retry(self, job_id: str, options: Mapping[str, Any] | None = None) -> JobOut:
        """A new job on the same input, with some options changed."""
        return self._run(self._acts.retry(job_id, options))

    def extract(self, job_id: str, options: Mapping[str, Any] | None = None) -> JobOut:
        """A new job that takes a mesh or slices from the field of this one."""
        return self._run(self._acts.extract(job_id, options))

    def download(
        self, job: JobOut, name: str, path: str | PathLike[str], moved: Moved = silent
    ) -> None:
        """A file of the result, checked against its SHA-256 (`Acts.download`)."""
        self._run(self._acts.download(job, name, Path(path), moved))

    def _run(self, steps: Steps[T]) -> T:
        try:
            step = next(steps)
            while True:
                if isinstance(step, Pause):
                    time.sleep(step.seconds)
                    step = steps.send(None)
                    continue
                try:
                    answer = self._http.request(**self._arguments(step))
                except httpx2.TransportError as error:
                    step = steps.throw(self._unreachable(error))
                else:
                    step = steps.send(answer)
        except StopIteration as end:
            result: T = end.value
            return result


class AsyncClient(_Connection):
    """As `Client`; what is read from disk or written there is a few megabytes at a time."""

    def __init__(self, server: str, key: str | None = None, *, patience: float = PATIENCE_SECONDS):
        super().__init__(server, key, patience)
        self._http = httpx2.AsyncClient(follow_redirects=True)

    async def __aenter__(self) -> AsyncClient:
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        await self.close()

    async def close(self) -> None:
        """Hang up."""
        await self._http.aclose()

    async def submit(
        self,
        cloud: str | PathLike[str],
        options: Mapping[str, Any] | None = None,
        *,
        label: str = "",
        upload: str | None = None,
        moved: Moved = silent,
        began: Callable[[str], None] = silent,
    ) -> JobOut:
        """Send a cloud, in pieces that resume, and queue its reconstruction."""
        return await self._run(
            self._acts.submit(
                Path(cloud), options, label=label, upload=upload, moved=moved, began=began
            )
        )

    async def job(self, job_id: str, wait: float = 0.0) -> JobOut:
        """The job as it stands, or as soon as its state is another, within `wait` seconds."""
        return await self._run(self._acts.job(job_id, wait))

    async def jobs(
        self, *, states: Sequence[str] = (), label: str | None = None, limit: int = 50
    ) -> list[JobOut]:
        """One's jobs, newest first."""
        return await self._run(self._acts.jobs(states=states, label=label, limit=limit))

    async def wait(self, job_id: str, looked: Looked = silent) -> JobOut:
        """The job once it has ended; `looked` is told of it every two seconds."""
        return await self._run(self._acts.wait(job_id, looked))

    async def cancel(self, job_id: str, *, keep: bool = False) -> JobOut:
        """Ask the job to stop; keep: have the surface so far as its result."""
        return await self._run(self._acts.cancel(job_id, keep=keep))

    async def delete(self, job_id: str) -> None:
        """Remove the job and its files."""
        await self._run(self._acts.delete(job_id))

    async def retry(self, job_id: str, options: Mapping[str, Any] | None = None) -> JobOut:
        """A new job on the same input, with some options changed."""
        return await self._run(self._acts.retry(job_id, options))

    async def extract(self, job_id: str, options: Mapping[str, Any] | None = None) -> JobOut:
        """A new job that takes a mesh or slices from the field of this one."""
        return await self._run(self._acts.extract(job_id, options))

    async def download(
        self, job: JobOut, name: str, path: str | PathLike[str], moved: Moved = silent
    ) -> None:
        """A file of the result, checked against its SHA-256."""
        await self._run(self._acts.download(job, name, Path(path), moved))

    async def _run(self, steps: Steps[T]) -> T:
        try:
            step = next(steps)
            while True:
                if isinstance(step, Pause):
                    await asyncio.sleep(step.seconds)
                    step = steps.send(None)
                    continue
                try:
                    answer = await self._http.request(**self._arguments(step))
                except httpx2.TransportError as error:
                    step = steps.throw(self._unreachable(error))
                else:
                    step = steps.send(answer)
        except StopIteration as end:
            result: T = end.value
            return result
