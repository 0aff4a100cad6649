"""What became of a job's webhooks."""

from __future__ import annotations

from datetime import UTC, datetime

from fastapi import APIRouter
from pydantic import BaseModel, ConfigDict, Field

from service.access.dependency import CallerDep
from service.jobs.routes import JobId
from service.responses import problems
from service.state import StateDep

router = APIRouter(tags=["webhooks"])


class DeliveryOut(BaseModel):
    """One try to deliver one event."""

    model_config = ConfigDict(title="Delivery")

    event_id: str
    number: int = Field(description="Of the try, from 1.")
    at: datetime
    status: int = Field(description="HTTP status of the answer; 0 if there was none.")
    error: str


class DeliveriesOut(BaseModel):
    """The latest tries first."""

    model_config = ConfigDict(title="Deliveries")

    deliveries: list[DeliveryOut]


@router.get("/jobs/{job_id}/deliveries", responses=problems("job.not_found", "job.expired"))
def deliveries(job_id: JobId, caller: CallerDep, state: StateDep) -> DeliveriesOut:
    """The log of the job's webhooks."""
    state.jobs.get(caller, job_id)
    tries = [
        DeliveryOut(
            event_id=tried.event_id,
            number=tried.number,
            at=datetime.fromtimestamp(tried.at, UTC),
            status=tried.status,
            error=tried.error,
        )
        for tried in state.webhooks.log(job_id)
    ]
    return DeliveriesOut(deliveries=tries)
