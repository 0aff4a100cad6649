"""One line for every request that changes something or fails, with the job that it is about."""

from __future__ import annotations

import logging
import time

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.logs import about, job_in

log = logging.getLogger("mpf.api")

QUIET = frozenset({"GET", "HEAD", "OPTIONS"})
"""Polls come by the thousand; of these only failures of the service are written down."""


class RequestLog:
    """ASGI middleware."""

    def __init__(self, app: ASGIApp):
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        start = time.perf_counter()
        status = 0
        job = job_in(scope["path"])

        async def watched(message: Message) -> None:
            nonlocal status, job
            if message["type"] == "http.response.start":
                status = message["status"]
                job = job or job_in(_location(message))
            await send(message)

        with about(job):
            try:
                await self._app(scope, receive, watched)
            finally:
                if scope["method"] not in QUIET or status >= 500:
                    with about(job):
                        _write(scope, status, time.perf_counter() - start)


def _location(message: Message) -> str:
    for name, value in message.get("headers", ()):
        if name == b"location":
            return str(value.decode("latin-1"))
    return ""


def _write(scope: Scope, status: int, seconds: float) -> None:
    facts = {
        "method": scope["method"],
        "path": scope["path"],
        "status": status,
        "seconds": round(seconds, 4),
    }
    log.info("%s %s %s", scope["method"], scope["path"], status, extra={"about": facts})
