"""A received submission becomes a job."""

from __future__ import annotations

import hashlib
import json

from mpf_core.options import options_from, options_to_mapping
from service.access.caller import Caller
from service.artifacts.base import Artifacts
from service.jobs.commands import JobCommands
from service.jobs.model import Input, Job, JobState, new_job_id
from service.jobs.tiles import require_few
from service.settings import Settings
from service.uploads.check import check_content
from service.uploads.incoming import Resumable
from service.uploads.receive import Reference, Submission
from service.webhooks.wish import wish_from


class Intake:
    """The way from a file in `uploads/` to a queued job; the file is gone afterwards."""

    def __init__(
        self,
        commands: JobCommands,
        artifacts: Artifacts,
        resumable: Resumable,
        settings: Settings,
    ):
        self._commands = commands
        self._artifacts = artifacts
        self._resumable = resumable
        self._settings = settings

    def submit(self, caller: Caller, submission: Submission, idempotency_key: str) -> Job:
        """When this returns, input and record are on disk."""
        return self._submit(caller, submission, idempotency_key, _digest(submission))

    def submit_upload(self, caller: Caller, reference: Reference, idempotency_key: str) -> Job:
        """The same for an upload that came in pieces; it is gone once the job is accepted."""
        digest = _hashed([reference.upload, sorted(reference.fields.items())])
        before = self._commands.repeated(caller, idempotency_key, digest)
        if before is not None:
            return before
        upload = self._resumable.get(caller.owner, reference.upload)
        stored = self._resumable.as_stored(upload, self._artifacts.new_upload())
        job = self._submit(caller, Submission(stored, reference.fields), idempotency_key, digest)
        self._resumable.remove(upload)
        return job

    def _submit(
        self, caller: Caller, submission: Submission, idempotency_key: str, digest: str
    ) -> Job:
        stored = submission.stored
        try:
            chosen = options_from(submission.options())
            webhook = wish_from(submission.fields.get("webhook", ""))
            self._commands.require_room()
            points = check_content(stored, self._settings)
            require_few(points, chosen, self._settings.tiles_per_job)
            job = Job(
                id=new_job_id(),
                state=JobState.QUEUED,
                attempt=1,
                owner=caller.owner,
                label=submission.label(),
                options=options_to_mapping(chosen),
                webhook=webhook.as_record() if webhook else None,
                input=Input(stored.name, stored.header.format, stored.bytes, stored.sha256, points),
            )
            self._artifacts.adopt_input(job.id, stored.path, stored.header.format)
        finally:
            stored.path.unlink(missing_ok=True)
        return self._commands.accept(job, idempotency_key=idempotency_key, digest=digest)


def _digest(submission: Submission) -> str:
    """What makes two requests the same: the bytes, their name and what was asked of them."""
    stored = submission.stored
    return _hashed([stored.sha256, stored.name, sorted(submission.fields.items())])


def _hashed(told: list[object]) -> str:
    return hashlib.sha256(json.dumps(told).encode()).hexdigest()
