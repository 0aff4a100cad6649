"""RFC 9457 problems and the closed list of their codes.

A problem's `code` is stable: clients may branch on it. Codes of `mpf_core.errors` keep their names;
the rest of the list stands here. A job that ended badly carries the same object as an HTTP error.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import mpf_core.cloud.errors  # noqa: F401  so that its codes are in the catalogue
from mpf_core.errors import InputError, MPFError, TooLarge

MEDIA_TYPE = "application/problem+json"
TYPE_PREFIX = "urn:metric-phase-fields:problem:"


@dataclass(frozen=True)
class Kind:
    """What is common to all problems of one code."""

    status: int
    title: str


# Problems of the service itself. `mpf_core`'s own are added by `catalogue`.
SERVICE_KINDS: dict[str, Kind] = {
    "request.invalid": Kind(422, "The request does not fit the contract"),
    "request.malformed": Kind(400, "The request cannot be read"),
    "request.too_large": Kind(413, "The request is too large"),
    "request.range": Kind(416, "The file has no such range"),
    "request.media_type": Kind(415, "The media type is not supported"),
    "access.denied": Kind(401, "An API key is needed"),
    "access.host": Kind(421, "The request is for another host"),
    "access.origin": Kind(403, "The request comes from another origin"),
    "input.not_inspected": Kind(422, "The input could not be inspected within the limits"),
    "rate.exceeded": Kind(429, "Too many requests"),
    "quota.jobs": Kind(429, "Too many jobs at the same time"),
    "share.not_found": Kind(404, "There is no such share"),
    "method_not_allowed": Kind(405, "The method is not allowed here"),
    "not_found": Kind(404, "There is nothing here"),
    "job.not_found": Kind(404, "There is no such job"),
    "job.expired": Kind(410, "The job has expired"),
    "job.not_ready": Kind(409, "The job has no result yet"),
    "job.no_result": Kind(409, "The job ended without a result"),
    "artifact.not_found": Kind(404, "The job has no such artefact"),
    "upload.not_found": Kind(404, "There is no such upload"),
    "upload.offset": Kind(409, "The upload ends elsewhere"),
    "upload.incomplete": Kind(409, "The upload is not complete"),
    "upload.version": Kind(412, "The version of tus is not spoken here"),
    "upload.locked": Kind(423, "The upload is being written to"),
    "upload.checksum": Kind(460, "The piece is not what its checksum says"),
    "idempotency.conflict": Kind(409, "The Idempotency-Key stands for another request"),
    "queue.full": Kind(503, "The queue is full"),
    "service.unavailable": Kind(503, "The service cannot reach its store"),
    "storage.full": Kind(507, "The disk of the service is full"),
    "internal": Kind(500, "The service made an error"),
    "job.out_of_memory": Kind(500, "The job needed more memory than it may use"),
    "job.time_limit": Kind(500, "The job took longer than it may"),
    "job.crashed": Kind(500, "The job's process died again and again"),
}


@dataclass(eq=False)
class Problem(Exception):
    """One problem, raised by the service and rendered once, by the handlers."""

    code: str
    detail: str
    where: str | None = None
    advice: str | None = None
    retry_after: int | None = None
    """Seconds after which another try makes sense."""

    def kind(self) -> Kind:
        """Status and title of this code."""
        return catalogue()[self.code]

    def as_dict(self, instance: str | None = None) -> dict[str, Any]:
        """The object as RFC 9457 has it, with `code`, `where` and `advice` as extensions."""
        kind = self.kind()
        members = {
            "type": TYPE_PREFIX + self.code,
            "title": kind.title,
            "status": kind.status,
            "detail": self.detail,
            "code": self.code,
            "where": self.where,
            "advice": self.advice,
            "instance": instance,
        }
        return {name: value for name, value in members.items() if value is not None}


def problem_from(error: MPFError) -> Problem:
    """The problem that says what `error` says."""
    return Problem(error.code, error.message, where=error.where, advice=error.advice)


def catalogue() -> dict[str, Kind]:
    """Every code that a client can meet."""
    core = {cls.code: Kind(_status_of(cls), _title_of(cls)) for cls in _tree(MPFError)}
    return core | SERVICE_KINDS


def _tree(root: type[MPFError]) -> Iterator[type[MPFError]]:
    yield root
    for child in root.__subclasses__():
        yield from _tree(child)


def _status_of(cls: type[MPFError]) -> int:
    if issubclass(cls, TooLarge):
        return 413
    return 422 if issubclass(cls, InputError) else 500


def _title_of(cls: type[MPFError]) -> str:
    return (cls.__doc__ or cls.code).strip().splitlines()[0].rstrip(".")
