"""Meshes and slices from the field that a job has fitted: jobs of seconds, without refitting."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mpf_core.extraction_options import extraction_from, extraction_to_mapping, inherited
from service.access.caller import Caller
from service.artifacts.base import Artifacts
from service.jobs.commands import JobCommands, digest_of, not_found
from service.jobs.model import EXTRACTION, Input, Job, JobState, new_job_id

FIELD = "field.safetensors"


def extract(
    jobs: JobCommands,
    artifacts: Artifacts,
    caller: Caller,
    job_id: str,
    changes: Mapping[str, Any],
    label: str,
    idempotency_key: str = "",
) -> Job:
    """A new job on the field of `job_id`, which may go before it.

    Options of the surface that are not named stay as they were there. Raises Problem if there is no
    such job or it has no field, OptionsError.
    """
    parent = jobs.get(caller, job_id)
    options = extraction_from(inherited(parent.options) | dict(changes))
    given = _field_of(jobs, caller, parent)
    job = Job(
        id=new_job_id(),
        state=JobState.QUEUED,
        attempt=1,
        kind=EXTRACTION,
        parent=parent.id,
        owner=caller.owner,
        label=label or parent.label,
        options=extraction_to_mapping(options),
        input=given,
    )
    jobs.require_room()
    try:
        if parent.kind == EXTRACTION:
            artifacts.share_input(parent.id, job.id)
        else:
            artifacts.share_field(parent.id, parent.result_attempt, FIELD, job.id)
    except FileNotFoundError as error:  # it was removed just now
        raise not_found(job_id) from error
    digest = digest_of("extraction", job_id, dict(changes), label)
    return jobs.accept(job, idempotency_key=idempotency_key, digest=digest)


def _field_of(jobs: JobCommands, caller: Caller, parent: Job) -> Input | None:
    """The field as an input: of a fit its result, of an extraction what that was given."""
    if parent.kind == EXTRACTION:
        return parent.input
    about = jobs.artifact_of(caller, parent.id, FIELD).artifacts[FIELD]
    return Input(FIELD, "safetensors", about.bytes, about.sha256)
