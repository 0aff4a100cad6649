"""A request body becomes a file in the store and a mapping of options."""

from __future__ import annotations

import json
from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from typing import Any

import anyio
from anyio import to_thread
from starlette.requests import Request

from mpf_core.cloud.limits import Limits
from mpf_core.errors import OptionsError
from service.artifacts.base import Artifacts
from service.problems import Problem
from service.settings import Settings
from service.uploads.multipart import PartBegins, PartData, form_events
from service.uploads.sink import Stored, UploadSink, too_large

FIELD_BYTES = 64 * 1024
"""Longest plain field of a form; the options need a few hundred bytes."""

WRITE_BYTES = 512 * 1024
"""Chunks are gathered to about this size before a thread writes them."""

FORM_OVERHEAD = 256 * 1024
"""What a form may weigh beside its file."""

RAW_TYPES = frozenset({"application/octet-stream", "text/plain", "model/ply"})

FIELDS = ("options", "label", "webhook")

LABEL_CHARACTERS = 200

DRAIN_BYTES, DRAIN_SECONDS = 4 * 2**20, 2.0


@dataclass
class Submission:
    """What a caller sent."""

    stored: Stored
    fields: dict[str, str] = field(default_factory=dict)

    def options(self) -> dict[str, Any]:
        """The options as the caller wrote them; raises OptionsError if that is not an object."""
        return parse_options(self.fields.get("options", ""))

    def label(self) -> str:
        """The caller's word for the job; raises Problem if it is too long."""
        label = self.fields.get("label", "")
        if len(label) > LABEL_CHARACTERS:
            raise Problem(
                "request.invalid", f"the label has more than {LABEL_CHARACTERS} characters",
                where="label",
            )  # fmt: skip
        return label


@dataclass(frozen=True)
class Reference:
    """A job of an upload that is here already; `fields` as a form would have them."""

    upload: str
    fields: dict[str, str]


async def reference_in(request: Request) -> Reference | None:
    """The upload that a JSON body speaks of, or None for other bodies; raises Problem."""
    kind = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if kind != "application/json":
        return None
    text = await _text_of("body", request.stream())
    try:
        given = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise Problem("request.malformed", "the body is not JSON") from error
    upload = given.get("upload") if isinstance(given, dict) else None
    if not isinstance(upload, str) or not set(given) <= {"upload", *FIELDS}:
        raise Problem(
            "request.invalid", "the body is not an object with `upload`", where="upload",
            advice='Send {"upload": "/uploads/…", "options": {…}}.',
        )  # fmt: skip
    fields = {name: given[name] for name in FIELDS if name in given}
    if not isinstance(fields.get("label", ""), str):
        raise Problem("request.invalid", "the label is not a text", where="label")
    told = {n: v if isinstance(v, str) else json.dumps(v) for n, v in fields.items()}
    return Reference(upload.removeprefix("/uploads/"), told)


def parse_options(text: str) -> dict[str, Any]:
    """A JSON object of options; an empty text means none."""
    if not text.strip():
        return {}
    try:
        given = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise OptionsError(
            f"options is not JSON: {error}", where="options", advice='Send {"preset": "draft"}.'
        ) from error
    if not isinstance(given, dict):
        raise OptionsError(
            "options is not a JSON object", where="options", advice='Send {"preset": "draft"}.'
        )
    return given


class Receiver:
    """Takes uploads in."""

    def __init__(self, store: Artifacts, settings: Settings):
        self._store = store
        self._max_bytes = settings.upload_bytes
        self._limits = Limits(max_bytes=settings.upload_bytes, max_points=settings.max_points)

    async def submission(self, request: Request) -> Submission:
        """A multipart form with one part `file` and plain fields, or the file itself as the body.

        With a bare body, its name, the options and the label stand in the query.
        """
        self._check_length(request)
        try:
            kind = request.headers.get("content-type", "").partition(";")[0].strip().lower()
            if kind in RAW_TYPES:
                query = dict(request.query_params)
                stored = await self._store_part(query.pop("name", ""), request.stream())
                return Submission(stored, {n: query[n] for n in FIELDS if n in query})
            return await self._read_form(request)
        except BaseException as error:
            if isinstance(error, Exception):
                await _drain(request)
            raise

    async def _read_form(self, request: Request) -> Submission:
        fields: dict[str, str] = {}
        stored: Stored | None = None
        events = form_events(request.headers.get("content-type", ""), request.stream())
        async for event in events:
            if not isinstance(event, PartBegins):
                continue
            if event.name == "file" and stored is None:
                stored = await self._store_part(event.filename or "", _part(events))
            elif event.name == "file" or event.name in fields:
                raise Problem("request.invalid", f"there are two parts {event.name}")
            else:
                fields[event.name] = await _text_of(event.name, _part(events))
        if stored is None:
            raise Problem(
                "request.invalid", "the form has no part named file", where="file",
                advice="Send the cloud as the part `file`.",
            )  # fmt: skip
        return Submission(stored, fields)

    async def _store_part(self, name: str, chunks: AsyncIterator[bytes]) -> Stored:
        with UploadSink(self._store.new_upload(), name, limits=self._limits) as sink:
            gathered: list[bytes] = []
            size = 0
            async for chunk in chunks:
                gathered.append(chunk)
                size += len(chunk)
                if size >= WRITE_BYTES:
                    await to_thread.run_sync(sink.write, b"".join(gathered))
                    gathered, size = [], 0
            await to_thread.run_sync(sink.write, b"".join(gathered))
            return await to_thread.run_sync(sink.finish)

    def _check_length(self, request: Request) -> None:
        """Refuse what is too long by its own account, before a byte of it is read."""
        try:
            length = int(request.headers.get("content-length", "0"))
        except ValueError:
            length = 0
        if length > self._max_bytes + FORM_OVERHEAD:
            raise too_large(self._max_bytes)


async def _part(events: AsyncIterator[Any]) -> AsyncIterator[bytes]:
    """The bytes of the part that has just begun."""
    async for event in events:
        if not isinstance(event, PartData):
            return
        yield event.data


async def _text_of(name: str, chunks: AsyncIterator[bytes]) -> str:
    data = b""
    async for chunk in chunks:
        data += chunk
        if len(data) > FIELD_BYTES:
            raise Problem("request.too_large", f"the part {name} is too long", where=name)
    try:
        return data.decode()
    except UnicodeDecodeError as error:
        raise Problem("request.malformed", f"the part {name} is not UTF-8", where=name) from error


async def _drain(request: Request) -> None:
    """Read a little of what is still coming, so that most clients see the answer, not a reset."""
    seen = 0
    with anyio.move_on_after(DRAIN_SECONDS):
        try:
            async for chunk in request.stream():
                seen += len(chunk)
                if seen > DRAIN_BYTES:
                    return
        except Exception:  # noqa: S110  the connection is gone, or the stream was read to its end
            pass
