"""Every error leaves as application/problem+json: the handlers, and the limit on bodies."""

from __future__ import annotations

import errno
import logging
import secrets
from collections.abc import Callable, Mapping
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse, Response
from redis.exceptions import OutOfMemoryError, ReadOnlyError
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect
from starlette.routing import Match
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from mpf_core.errors import MPFError
from service.artifacts.base import StoreUnavailable
from service.connection import UNREACHABLE
from service.problems import MEDIA_TYPE, Problem, problem_from

log = logging.getLogger("mpf.api")

_BY_STATUS = {
    404: "not_found",
    405: "method_not_allowed",
    413: "request.too_large",
    415: "request.media_type",
    400: "request.malformed",
}

_METHODS = ("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS")


def respond(
    problem: Problem, request: Request | None = None, headers: Mapping[str, str] | None = None
) -> JSONResponse:
    """The response that carries `problem`."""
    instance = request.url.path if request is not None else None
    extra = dict(headers or {})
    if problem.retry_after is not None:
        extra["Retry-After"] = str(problem.retry_after)
    body = problem.as_dict(instance)
    if body["status"] == 401:
        extra["WWW-Authenticate"] = "Bearer"
    if problem.code == "upload.version":
        extra["Tus-Version"] = "1.0.0"
    return JSONResponse(body, body["status"], headers=extra, media_type=MEDIA_TYPE)


def install(app: FastAPI) -> None:
    """Make `app` answer every error as a problem."""
    app.add_exception_handler(Problem, _on_problem)
    app.add_exception_handler(MPFError, _on_core_error)
    app.add_exception_handler(RequestValidationError, _on_invalid)
    app.add_exception_handler(HTTPException, _on_http)
    for unreachable in (*UNREACHABLE, ReadOnlyError, OutOfMemoryError):
        app.add_exception_handler(unreachable, _on_redis)
    app.add_exception_handler(ClientDisconnect, _on_disconnect)
    app.add_exception_handler(OSError, _on_disk)
    app.add_exception_handler(Exception, _on_anything)


async def _on_problem(request: Request, error: Exception) -> Response:
    assert isinstance(error, Problem)
    return respond(error, request)


async def _on_core_error(request: Request, error: Exception) -> Response:
    assert isinstance(error, MPFError)
    return respond(problem_from(error), request)


async def _on_invalid(request: Request, error: Exception) -> Response:
    assert isinstance(error, RequestValidationError)
    first: Mapping[str, Any] = next(iter(error.errors()), {})
    place = ".".join(str(part) for part in first.get("loc", ()))
    detail = str(first.get("msg", "the request does not fit the contract"))
    return respond(Problem("request.invalid", detail, where=place or None), request)


async def _on_http(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    code = _BY_STATUS.get(error.status_code)
    if code is None:
        return await _on_anything(request, error)
    headers = dict(error.headers or {})
    if code == "method_not_allowed":
        headers["Allow"] = ", ".join(_allowed(request))
    return respond(Problem(code, f"{request.method} {request.url.path}: {error.detail}"),
                   request, headers)  # fmt: skip


def _allowed(request: Request) -> list[str]:
    """All methods of this path; the error itself knows those of the first route only."""
    routes = request.app.router.routes
    return [
        method
        for method in _METHODS
        if any(r.matches({**request.scope, "method": method})[0] is Match.FULL for r in routes)
    ]


async def _on_disconnect(request: Request, _error: Exception) -> Response:
    """Nobody is there to read this; only the log would cry wolf."""
    return respond(Problem("request.malformed", "the body was cut off"), request)


async def _on_redis(request: Request, error: Exception) -> Response:
    log.warning("redis: %s", error)
    return respond(unavailable(), request)


async def _on_disk(request: Request, error: Exception) -> Response:
    if isinstance(error, StoreUnavailable):
        log.warning("%s", error)
        return respond(unavailable("the artefact store does not answer"), request)
    if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
        return respond(Problem("storage.full", "there is no room for this input",
                               advice="Delete jobs, or wait until old ones expire.",
                               retry_after=60), request)  # fmt: skip
    return await _on_anything(request, error)


async def _on_anything(request: Request, error: Exception) -> Response:
    incident = secrets.token_hex(4)
    log.error("incident %s: %s %s", incident, request.method, request.url.path, exc_info=error)
    return respond(Problem("internal", f"incident {incident}: see the service's log"), request)


def unavailable(what: str = "the job store does not answer") -> Problem:
    """The problem of a service whose Redis, or whose object store, is away."""
    return Problem("service.unavailable", what,
                   advice="Try again; accepted jobs are not lost.", retry_after=2)  # fmt: skip


class BodyLimit:
    """Counts request bodies as they stream and answers 413 as a problem.

    Uploads have a limit of their own, in `uploads/`; `unlimited` says which paths those are.
    """

    def __init__(self, app: ASGIApp, limit: int, unlimited: Callable[[str, str], bool]):
        self._app = app
        self._limit = limit
        self._unlimited = unlimited

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http" or self._unlimited(scope["method"], scope["path"]):
            await self._app(scope, receive, send)
            return
        await _Counted(self._app, self._limit).run(scope, receive, send)


class _Counted:
    """One request under the limit."""

    def __init__(self, app: ASGIApp, limit: int):
        self._app = app
        self._limit = limit
        self._seen = 0
        self._started = False

    async def run(self, scope: Scope, receive: Receive, send: Send) -> None:
        declared = dict(scope["headers"]).get(b"content-length", b"0")
        if declared.isdigit() and int(declared) > self._limit:
            await self._refuse(scope, receive, send)
            return

        async def counted() -> Message:
            message = await receive()
            self._seen += len(message.get("body", b""))
            # The application gets nothing more; what it says of the cut body is replaced below.
            return {"type": "http.disconnect"} if self._seen > self._limit else message

        async def guarded(message: Message) -> None:
            if self._seen <= self._limit or self._started:
                self._started = True
                await send(message)

        try:
            await self._app(scope, counted, guarded)
        except Exception:
            if self._seen <= self._limit:
                raise
        if self._seen > self._limit and not self._started:
            await self._refuse(scope, receive, send)

    async def _refuse(self, scope: Scope, receive: Receive, send: Send) -> None:
        problem = Problem("request.too_large", f"the body has more than {self._limit} bytes")
        await respond(problem, Request(scope))(scope, receive, send)
