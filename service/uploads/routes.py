"""Looking at a file without making a job of it."""

from __future__ import annotations

from typing import Any

from anyio import CapacityLimiter, to_thread
from fastapi import APIRouter, Request

from mpf_core.cloud.errors import error_codes
from service.access.dependency import CallerDep
from service.responses import problems
from service.state import StateDep
from service.uploads.check import inspect_content
from service.uploads.schemas import InspectionOut

router = APIRouter(tags=["jobs"])

# Who waits for a turn must not hold a thread that other requests need.
_AT_ONCE = CapacityLimiter(2)

_BODY: dict[str, Any] = {
    "parameters": [
        {
            "name": "name",
            "in": "query",
            "required": False,
            "schema": {"type": "string"},
            "description": "With a bare body: the file's name.",
        }
    ],
    "requestBody": {
        "required": True,
        "content": {
            "multipart/form-data": {
                "schema": {
                    "type": "object",
                    "required": ["file"],
                    "properties": {
                        "file": {
                            "type": "string",
                            "contentMediaType": "application/octet-stream",
                            "description": "A point cloud, .ply or .xyz.",
                        }
                    },
                }
            },
            "application/octet-stream": {"schema": {"type": "string"}},
        },
    },
}


@router.post(
    "/inspect",
    openapi_extra=_BODY,
    responses=problems(
        "request.malformed",
        "request.media_type",
        "request.invalid",
        "input.not_inspected",
        *error_codes(),
        "storage.full",
    ),
)
async def inspect(request: Request, _caller: CallerDep, state: StateDep) -> InspectionOut:
    """Say what the reader makes of a cloud; nothing of it is kept."""
    submission = await state.receiver.submission(request)
    stored = submission.stored
    try:
        found = await to_thread.run_sync(inspect_content, stored, state.settings, limiter=_AT_ONCE)
    finally:
        stored.path.unlink(missing_ok=True)
    return InspectionOut.model_validate(found)
