"""What the service takes, told before anybody uploads."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, Field

from mpf_core.cloud.limits import MINIMUM_POINTS
from mpf_core.extraction_options import extraction_schema
from mpf_core.options import PRESETS, options_schema, options_to_mapping
from service.problems import catalogue
from service.settings import Settings


class Limits(BaseModel):
    """Sizes and times that hold for every job."""

    input_bytes: int
    points_least: int = Field(description="Distinct points.")
    points_most: int
    queued_jobs: int
    jobs_per_owner: int = Field(description="Queued and running; 0: no limit.")
    running_per_owner: int = Field(description="The others wait; 0: no limit.")
    job_seconds: float
    retention_seconds: float = Field(description="For which an ended job keeps its files, s.")


class Uploads(BaseModel):
    """How inputs may arrive in pieces."""

    tus: str = Field(description="Version of the protocol.")
    href: str
    seconds: float = Field(description="For which an interrupted upload waits, s.")


class Rate(BaseModel):
    """How fast fits have gone here."""

    points_per_second: float | None = Field(
        description="Samples at which a fit evaluates its field; None before the first. A step of "
        "one takes `surface_points` + `near_points` + `far_points` of them, and some more."
    )


class CodeOut(BaseModel):
    """A problem code with its HTTP status."""

    status: int
    title: str


class Capabilities(BaseModel):
    """Formats, limits, presets, options and problem codes."""

    formats: list[str]
    limits: Limits
    uploads: Uploads
    rate: Rate
    presets: dict[str, dict[str, Any]]
    options: dict[str, Any] = Field(description="JSON Schema of `options`.")
    extraction: dict[str, Any] = Field(description="JSON Schema of an extraction's `options`.")
    problems: dict[str, CodeOut]


def capabilities(settings: Settings, points_per_second: float | None) -> Capabilities:
    """As this instance is set up, and at which rate it has fitted lately."""
    return Capabilities(
        formats=["ply", "xyz"],
        limits=Limits(
            input_bytes=settings.upload_bytes,
            points_least=MINIMUM_POINTS,
            points_most=settings.max_points,
            queued_jobs=settings.queue_length,
            jobs_per_owner=settings.jobs_per_owner,
            running_per_owner=settings.running_per_owner,
            job_seconds=settings.job_seconds,
            retention_seconds=settings.retention_seconds,
        ),
        uploads=Uploads(tus="1.0.0", href="/uploads", seconds=settings.resumable_seconds),
        rate=Rate(points_per_second=points_per_second),
        presets={name: options_to_mapping(preset) for name, preset in PRESETS.items()},
        options=options_schema(),
        extraction=extraction_schema(),
        problems={
            code: CodeOut(status=kind.status, title=kind.title)
            for code, kind in sorted(catalogue().items())
        },
    )
