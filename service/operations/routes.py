"""GET /livez and GET /readyz."""

from __future__ import annotations

from fastapi import APIRouter, Response
from pydantic import BaseModel, Field

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
