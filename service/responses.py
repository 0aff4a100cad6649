"""What each endpoint may answer, and the OpenAPI document that says so."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi

from service.jobs.schemas import ProblemOut
from service.problems import MEDIA_TYPE, catalogue

_PROBLEM = {"$ref": "#/components/schemas/ProblemOut"}

# What any endpoint may answer, whatever it does.
_EVERYWHERE = (
    "access.denied", "access.host", "access.origin", "rate.exceeded", "request.too_large",
    "service.unavailable", "internal",
)  # fmt: skip


def problems(*codes: str) -> dict[int | str, dict[str, Any]]:
    """`responses=` for the problems that an endpoint may answer, one entry per status."""
    by_status: dict[int, list[str]] = {}
    known = catalogue()
    for code in (*codes, *_EVERYWHERE):
        by_status.setdefault(known[code].status, []).append(code)
    return {
        status: {
            "description": "Problem: " + ", ".join(f"`{code}`" for code in dict.fromkeys(listed)),
            "content": {MEDIA_TYPE: {"schema": _PROBLEM}},
        }
        for status, listed in sorted(by_status.items())
    }


def links(parameters: Mapping[str, str], *operations: str) -> dict[str, Any]:
    """What can be done next with what an answer names: OpenAPI's links, by operation."""
    return {name: {"operationId": name, "parameters": dict(parameters)} for name in operations}


OF_A_JOB = (
    "show", "cancel", "delete", "retry", "extraction", "events", "deliveries", "share", "mesh_glb",
    "mesh_ply", "field", "report", "preview_glb", "result_zip",
)  # fmt: skip
JOB_LINKS = links({"job_id": "$response.body#/id"}, *OF_A_JOB)

ACCEPTED: dict[int | str, dict[str, Any]] = {
    202: {
        "headers": {
            "Location": {"schema": {"type": "string"}, "description": "Where the job is."},
            "Retry-After": {"schema": {"type": "integer"}, "description": "s"},
        },
        "links": JOB_LINKS,
    }
}
"""Of every answer with a job that was made or changed."""

UNCHANGED: dict[int | str, dict[str, Any]] = {
    304: {"description": "The file is the one whose ETag was sent as If-None-Match."}
}


def describe(app: FastAPI) -> dict[str, Any]:
    """The OpenAPI document: FastAPI's, with problems where it would speak of its own errors."""
    found = get_openapi(
        title=app.title,
        version=app.version,
        openapi_version=app.openapi_version,
        summary=app.summary,
        routes=app.routes,
        separate_input_output_schemas=False,
    )
    schemas = found.setdefault("components", {}).setdefault("schemas", {})
    for theirs in ("HTTPValidationError", "ValidationError"):
        schemas.pop(theirs, None)
    schemas["ProblemOut"] = ProblemOut.model_json_schema()
    for path in found["paths"].values():
        for operation in path.values():
            _drop_foreign_errors(operation["responses"])
            if "416" in operation["responses"]:
                _tell_of_ranges(operation)
    # Classes are called JobOut beside the Job they show; clients know only one of the two.
    text = re.sub(r'(#/components/schemas/\w+?)Out"', r'\1"', json.dumps(found))
    described: dict[str, Any] = json.loads(text)
    components = described["components"]
    components["schemas"] = {
        name.removesuffix("Out"): schema for name, schema in sorted(components["schemas"].items())
    }
    return described


def _tell_of_ranges(operation: dict[str, Any]) -> None:
    """What every file answers to Range and If-None-Match."""
    responses = operation["responses"]
    responses["206"] = {
        "description": "The part of the file that Range asks for, or the parts.",
        "content": {kind: {} for kind in (*responses["200"]["content"], "multipart/byteranges")},
    }
    responses |= {str(status): told for status, told in UNCHANGED.items()}
    operation.setdefault("parameters", []).extend(
        {
            "name": name,
            "in": "header",
            "required": False,
            "schema": {"type": "string"},
            "description": about,
        }
        for name, about in (
            ("Range", "Only these bytes."),
            ("If-None-Match", "The ETag of the file that one has already."),
        )
    )


def _drop_foreign_errors(responses: dict[str, Any]) -> None:
    for status, response in list(responses.items()):
        if "HTTPValidationError" in json.dumps(response.get("content", {})):
            kept = response["content"].get(MEDIA_TYPE)
            if kept is None:
                del responses[status]
            else:
                response["content"] = {MEDIA_TYPE: kept}
