"""One place in an object store: S3, GCS, Azure, by URL. Keys are relative to it.

Credentials and endpoints are read from the variables that every tool of that store reads
(`AWS_ACCESS_KEY_ID`, `AWS_ENDPOINT_URL`, `GOOGLE_APPLICATION_CREDENTIALS`, `GOOGLE_BASE_URL`,
`AZURE_STORAGE_ACCOUNT_NAME`, `AZURE_STORAGE_ENDPOINT`).
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import Any

import obstore
from obstore.exceptions import AlreadyExistsError, BaseError
from obstore.store import from_url

from service.artifacts.base import NoSuchStore, StoreUnavailable
from service.settings import Settings

PIECE_BYTES = 8 * 2**20
"""Read by one request: an interruption costs no more, and no request lasts long."""

_ENDPOINTS = ("AWS_ENDPOINT_URL", "AZURE_STORAGE_ENDPOINT", "GOOGLE_BASE_URL")

# A store that is away is told of within half a minute; whoever can wait longer asks again.
_CLIENT: dict[str, Any] = {"timeout": "60s", "connect_timeout": "5s"}
_RETRY: Any = {
    "max_retries": 4,
    "retry_timeout": timedelta(seconds=20),
    "backoff": {
        "init_backoff": timedelta(milliseconds=100),
        "max_backoff": timedelta(seconds=2),
        "base": 2,
    },
}


@dataclass(frozen=True)
class Entry:
    """One object: its key, its size in bytes, and when it was written, s since 1970."""

    key: str
    size: int
    modified: float


class AlreadyThere(Exception):
    """There is an object of that key, which was not to be replaced."""


class Bucket:
    """Objects by key; each is whole or not there. Safe to share between threads."""

    def __init__(self, store: Any, signer: Any = None):
        """signer: the store under the name by which callers reach it; None: no links."""
        self._store = store
        self._signer = signer

    def put(self, key: str, data: bytes, *, new: bool = False) -> None:
        """Write an object; raises AlreadyThere if it is to be `new` and is not."""
        with _asking(f"put {key}"):
            try:
                obstore.put(self._store, key, data, mode="create" if new else "overwrite")
            except AlreadyExistsError as error:
                raise AlreadyThere(key) from error

    def put_file(self, key: str, path: Path, headers: Mapping[str, str] | None = None) -> None:
        """Write a file as an object, which appears when all of it has arrived."""
        with _asking(f"put {key}"):
            obstore.put(self._store, key, path, attributes=dict(headers) if headers else None)

    def get(self, key: str) -> bytes:
        """A small object; raises FileNotFoundError."""
        with _asking(f"get {key}"):
            return bytes(obstore.get(self._store, key).bytes())

    def entry(self, key: str) -> Entry:
        """What is known of an object; raises FileNotFoundError."""
        with _asking(f"head {key}"):
            return _entry(obstore.head(self._store, key))

    def read(self, key: str, start: int, end: int) -> Iterator[bytes]:
        """The bytes from `start` to before `end`, in pieces."""
        for begin in range(start, end, PIECE_BYTES):
            stop = min(end, begin + PIECE_BYTES)
            with _asking(f"get {key}"):
                try:
                    piece = obstore.get_range(self._store, key, start=begin, end=stop)
                except BaseError as error:
                    if "non-partial" not in str(error):
                        raise
                    piece = None
            if piece is None:
                yield from self._read_past(key, begin, end)
                return
            yield bytes(piece)

    def _read_past(self, key: str, start: int, end: int) -> Iterator[bytes]:
        """The same from a store that answers ranges with 200 instead of 206, as rclone's does."""
        place = 0
        with _asking(f"get {key}"):
            for chunk in obstore.get(self._store, key):
                piece = bytes(chunk)[max(0, start - place) : max(0, end - place)]
                place += len(chunk)
                if piece:
                    yield piece

    def fetch(self, entry: Entry, path: Path) -> None:
        """Copy an object to a file of this machine, which then is whole or not there."""
        beside = path.with_name(f".{path.name}.part")
        try:
            with beside.open("wb") as file:
                for piece in self.read(entry.key, 0, entry.size):
                    file.write(piece)
            beside.replace(path)
        finally:
            beside.unlink(missing_ok=True)

    def copy(self, source: str, target: str) -> None:
        """Copy within the store; raises FileNotFoundError."""
        with _asking(f"copy {source}"):
            obstore.copy(self._store, source, target)

    def children(self, folder: str) -> tuple[list[str], list[Entry]]:
        """Names of the folders, and the objects, right below `folder`."""
        with _asking(f"list {folder}"):
            found = obstore.list_with_delimiter(self._store, folder)
            folders = [prefix.rpartition("/")[2] for prefix in found["common_prefixes"]]
            return folders, [_entry(one) for one in found["objects"]]

    def below(self, folder: str) -> Iterator[Entry]:
        """All objects below `folder`, however deep."""
        with _asking(f"list {folder}"):
            for batch in obstore.list(self._store, folder):
                yield from (_entry(one) for one in batch)

    def delete(self, keys: Sequence[str]) -> None:
        """Remove objects; those that are not there are no error."""
        if keys:
            with _asking(f"delete {keys[0]}"), suppress(FileNotFoundError):
                obstore.delete(self._store, list(keys))

    def link(self, key: str, seconds: float) -> str | None:
        """A URL that reads the object for a while without any credentials."""
        if self._signer is None:
            return None
        with _asking(f"sign {key}"):
            return str(obstore.sign(self._signer, "GET", key, timedelta(seconds=seconds)))


def bucket_at(settings: Settings) -> Bucket:
    """The place that the settings name; raises NoSuchStore."""
    assert settings.store_url is not None
    try:
        store = _opened(settings.store_url)
        if not settings.store_link_seconds or settings.store_url.startswith("memory:"):
            return Bucket(store)
        endpoint = settings.store_link_endpoint
        return Bucket(store, _opened(settings.store_url, endpoint) if endpoint else store)
    except (BaseError, ValueError) as error:
        raise NoSuchStore(f"MPF_STORE_URL: {error}") from error


def _opened(url: str, endpoint: str = "") -> Any:
    name = "base_url" if url.startswith("gs:") else "endpoint"
    config: Any = {name: endpoint} if endpoint else None
    client: Any = dict(_CLIENT)
    if any(os.environ.get(name, "").startswith("http://") for name in _ENDPOINTS):
        client["allow_http"] = True  # whoever writes http:// means it
    return from_url(url, config=config, client_options=client, retry_config=_RETRY)


def _entry(about: Any) -> Entry:
    return Entry(about["path"], int(about["size"]), about["last_modified"].timestamp())


@contextmanager
def _asking(what: str) -> Iterator[None]:
    """Errors of the store as ours; FileNotFoundError stays what it is."""
    try:
        yield
    except FileNotFoundError:
        raise
    except BaseError as error:
        reason = str(error).strip().splitlines()[0][:300]
        raise StoreUnavailable(f"the artefact store: {what}: {reason}") from error
