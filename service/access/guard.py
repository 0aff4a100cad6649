"""What a browser may be tricked into: without API keys, other sites must not reach this service.

A page can make a browser send requests to 127.0.0.1, and can point its own name there. So where no
key is asked for, the Host must be one of ours, and a request that changes something must not come
from a page of another origin.
"""

from __future__ import annotations

from starlette.datastructures import Headers
from starlette.requests import Request
from starlette.types import ASGIApp, Receive, Scope, Send

from service.problem_handlers import respond
from service.problems import Problem
from service.settings import Settings

LOOPBACK_NAMES = frozenset({"localhost", "127.0.0.1", "[::1]"})
SAFE_METHODS = frozenset({"GET", "HEAD", "OPTIONS"})


class Guard:
    """ASGI middleware; lets everything pass where keys are required."""

    def __init__(self, app: ASGIApp, settings: Settings):
        self._app = app
        self._open = settings.require_keys
        self._hosts = LOOPBACK_NAMES | frozenset(settings.allowed_hosts)
        self._origins = frozenset(settings.cors_origins)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        problem = None if self._open or scope["type"] != "http" else self._objection(scope)
        if problem is None:
            await self._app(scope, receive, send)
        else:
            await respond(problem, Request(scope))(scope, receive, send)

    def _objection(self, scope: Scope) -> Problem | None:
        headers = Headers(scope=scope)
        host = headers.get("host", "")
        if _without_port(host) not in self._hosts:
            return Problem(
                "access.host", "this name is not one of the service's", where="Host",
                advice="Use 127.0.0.1, or add the name to MPF_ALLOWED_HOSTS.",
            )  # fmt: skip
        origin = headers.get("origin")
        if scope["method"] in SAFE_METHODS or origin is None or origin in self._origins:
            return None
        if origin.partition("://")[2] == host:
            return None
        return Problem(
            "access.origin", "pages of another origin may not change anything here",
            where="Origin", advice="Add the origin to MPF_CORS_ORIGINS.",
        )  # fmt: skip


def _without_port(host: str) -> str:
    name, found, port = host.rpartition(":")
    return name if found and port.isdigit() else host
