"""Links to stores that no test can reach, as far as they can be judged without."""

from __future__ import annotations

import json
from urllib.parse import unquote, urlsplit

import pytest
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

from service.artifacts.bucket import bucket_at
from service.settings import Settings


def test_links_to_googles_store_are_signed_on_this_machine(
    settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    key = rsa.generate_private_key(65537, 2048).private_bytes(
        Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()
    )
    account = {"client_email": "mpf@example", "private_key": key.decode(), "private_key_id": "1"}
    monkeypatch.setenv("GOOGLE_SERVICE_ACCOUNT_KEY", json.dumps(account))
    given = settings.model_copy(update={"store_url": "gs://bucket/some/prefix"})
    elsewhere = given.model_copy(update={"store_link_endpoint": "https://files.example"})
    for there, host in ((given, "storage.googleapis.com"), (elsewhere, "files.example")):
        link = bucket_at(there).link("jobs/1/mesh.glb", 60)
        assert link is not None
        found = urlsplit(link)
        assert (found.scheme, found.netloc) == ("https", host)
        assert unquote(found.path) == "/bucket/some/prefix/jobs/1/mesh.glb"
        assert "X-Goog-Signature=" in found.query
