"""Meshes of the unfinished fit, on their way to those who follow the job."""

from __future__ import annotations

import hashlib
import logging

from service.artifacts.base import Artifacts
from service.connection import UNREACHABLE
from service.jobs.lease import Lease, Refused
from service.jobs.model import Preview
from service.jobs.store import JobStore

log = logging.getLogger("mpf.worker")


class PreviewWriter:
    """Each preview takes the place of the one before; a lost one never ends the job."""

    def __init__(self, store: JobStore, artifacts: Artifacts, lease: Lease):
        self._store = store
        self._artifacts = artifacts
        self._lease = lease
        self._number = 0

    def __call__(self, glb: bytes) -> None:
        """Put the mesh where the API finds it, then tell of it."""
        job_id, attempt = self._lease.job_id, self._lease.attempt
        self._number += 1
        about = Preview(attempt, self._number, len(glb), hashlib.sha256(glb).hexdigest())
        try:
            self._artifacts.write_preview(job_id, attempt, glb)
            self._store.preview(self._lease, about)
        except Refused as refusal:
            log.info("job %s: preview refused: %s", job_id, refusal)
        except (OSError, *UNREACHABLE) as error:
            log.warning("job %s: preview not shown: %s", job_id, error)
