"""What each endpoint may answer, as OpenAPI documents it."""

from __future__ import annotations

from typing import Any

from service.jobs.schemas import ProblemOut
from service.problems import MEDIA_TYPE, catalogue


def problems(*codes: str) -> dict[int | str, dict[str, Any]]:
    """`responses=` for the problems that an endpoint may answer, one entry per status."""
    by_status: dict[int, list[str]] = {}
    known = catalogue()
    for code in (*codes, "service.unavailable", "internal"):
        by_status.setdefault(known[code].status, []).append(code)
    return {
        status: {
            "model": ProblemOut,
            "description": "Problem: " + ", ".join(f"`{code}`" for code in listed),
            "content": {MEDIA_TYPE: {}},
        }
        for status, listed in by_status.items()
    }
