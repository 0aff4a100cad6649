"""`create_app(settings)`: wiring and nothing else."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import cache
from importlib.metadata import version

from fastapi import FastAPI
from starlette.middleware.cors import CORSMiddleware

from service import problem_handlers
from service.access.guard import Guard
from service.access.routes import router as shares
from service.artifacts.routes import router as artifacts
from service.events.routes import router as events
from service.jobs.extraction_routes import router as extractions
from service.jobs.routes import router as jobs
from service.operations.routes import router as operations
from service.request_log import RequestLog
from service.responses import describe
from service.settings import Settings
from service.state import build_state
from service.uploads import tus
from service.uploads.routes import router as inspection
from service.web.routes import router as web
from service.webhooks.routes import router as webhooks

ALLOWED_HEADERS = ("Authorization", "Content-Type", "Idempotency-Key", "Last-Event-ID")
EXPOSED_HEADERS = ("Location", "Retry-After", "ETag")


def _is_upload(method: str, path: str) -> bool:
    """Whether a body may be longer than others; it is counted elsewhere."""
    if method == "PATCH":
        return path.startswith("/uploads/")
    return method == "POST" and path in ("/jobs", "/inspect")


def create_app(settings: Settings) -> FastAPI:
    """The HTTP service; it connects to nothing before the first request."""

    @asynccontextmanager
    async def lifespan(_app: FastAPI) -> AsyncIterator[None]:
        state.artifacts.prepare()
        state.resumable.prepare()
        yield
        await state.hub.close()
        await state.polls.close()
        state.redis.close()

    app = FastAPI(
        title="Metric-Phase Fields",
        version=version("metric-phase-fields"),
        summary="Surfaces from raw, unoriented point clouds.",
        lifespan=lifespan,
        redoc_url=None,
        generate_unique_id_function=lambda route: route.name,
    )
    state = build_state(settings)
    app.state.mpf = state
    problem_handlers.install(app)
    app.add_middleware(problem_handlers.BodyLimit, limit=settings.body_bytes, unlimited=_is_upload)
    app.add_middleware(Guard, settings=settings)
    if settings.cors_origins:
        app.add_middleware(
            CORSMiddleware,
            allow_origins=settings.cors_origins,
            allow_methods=["GET", "POST", "PATCH", "DELETE", "HEAD"],
            allow_headers=[*ALLOWED_HEADERS, *tus.ALLOWED_HEADERS],
            expose_headers=[*EXPOSED_HEADERS, *tus.EXPOSED_HEADERS],
        )
    app.add_middleware(RequestLog)
    for router in (
        jobs, extractions, tus.router, inspection, events, artifacts, shares, webhooks, operations,
        web,
    ):  # fmt: skip
        app.include_router(router)
    app.openapi = cache(lambda: describe(app))  # type: ignore[method-assign]
    return app
