"""Where uploads in pieces are kept: beside the artefacts."""

from __future__ import annotations

from redis import Redis

from service.artifacts.opened import artifacts_of
from service.artifacts.store import ArtifactStore
from service.settings import Settings
from service.uploads.incoming import Resumable
from service.uploads.resumable import ResumableStore


def uploads_of(settings: Settings, redis: Redis) -> Resumable:
    """Those of the folder, or of the bucket, that the settings name."""
    artifacts = artifacts_of(settings)
    if isinstance(artifacts, ArtifactStore):
        return ResumableStore(artifacts.root, settings)
    from service.artifacts.bucket import bucket_at
    from service.uploads.lock_store import UploadLocks
    from service.uploads.object_uploads import ObjectUploads

    return ObjectUploads(bucket_at(settings), UploadLocks(redis), settings)
