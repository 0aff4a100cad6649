"""Health, metrics and capabilities."""

from __future__ import annotations

from fastapi import APIRouter, Response
from fastapi.responses import PlainTextResponse
from pydantic import BaseModel, Field

from service.access.dependency import CallerDep
from service.operations.capabilities import Capabilities
from service.operations.capabilities import capabilities as capabilities_of
from service.operations.metrics import MEDIA_TYPE
from service.responses import problems
from service.state import StateDep

router = APIRouter(tags=["operations"])


class Live(BaseModel):
    """The process answers."""

    status: str = "live"


class Ready(BaseModel):
    """What the service depends on, and whether it is there."""

    status: str = Field(description="ready, degraded (no worker is alive: jobs wait), unavailable")
    redis: bool
    storage: bool
    workers: int


@router.get("/livez")
def livez() -> Live:
    """The process is alive; says nothing about what it depends on."""
    return Live()


@router.get("/readyz", responses={503: {"model": Ready, "description": "status unavailable"}})
def readyz(state: StateDep, response: Response) -> Ready:
    """Redis, the artefact store and the workers."""
    found = state.health.readiness()
    response.status_code = 503 if found.status == "unavailable" else 200
    return Ready(
        status=found.status, redis=found.redis, storage=found.storage, workers=found.workers
    )


@router.get("/metrics", response_class=PlainTextResponse, responses=problems("access.denied"))
def metrics(state: StateDep, _caller: CallerDep) -> PlainTextResponse:
    """Figures for Prometheus."""
    return PlainTextResponse(state.metrics.text(), media_type=MEDIA_TYPE)


@router.get("/capabilities", responses=problems("access.denied"))
def capabilities(state: StateDep, _caller: CallerDep) -> Capabilities:
    """Formats, limits, presets, the options' JSON Schema, and all problem codes."""
    return capabilities_of(state.settings, state.rate.points_per_second())
