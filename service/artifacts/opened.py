"""Which store of artefacts a process uses."""

from __future__ import annotations

from pathlib import Path
from urllib.parse import unquote, urlsplit

from service.artifacts.base import Artifacts
from service.artifacts.store import ArtifactStore
from service.settings import Settings


def artifacts_of(settings: Settings) -> Artifacts:
    """The folder `MPF_DATA_DIR`, or what `MPF_STORE_URL` names.

    Connects to nothing. Raises NoSuchStore.
    """
    url = settings.store_url
    if url is None:
        return ArtifactStore(settings.data_dir)
    if url.startswith("file:"):
        return ArtifactStore(Path(unquote(urlsplit(url).path)))
    # Loaded only where it is wanted: most services run on one machine.
    from service.artifacts.bucket import bucket_at
    from service.artifacts.object_store import ObjectArtifacts

    return ObjectArtifacts(bucket_at(settings), settings.data_dir, settings.store_link_seconds)
