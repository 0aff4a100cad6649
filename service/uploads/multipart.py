"""A multipart body as events, while it streams; nothing is buffered but one chunk."""

from __future__ import annotations

from collections.abc import AsyncIterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from python_multipart.exceptions import FormParserError
from python_multipart.multipart import MultipartParser, parse_options_header

from service.problems import Problem

if TYPE_CHECKING:
    from python_multipart.multipart import MultipartCallbacks

MOST_PARTS = 16


@dataclass(frozen=True)
class PartBegins:
    """A part of the form starts; `filename` is None for a plain field."""

    name: str
    filename: str | None


@dataclass(frozen=True)
class PartData:
    """Some bytes of the current part."""

    data: bytes


@dataclass(frozen=True)
class PartEnds:
    """The current part is complete."""


FormEvent = PartBegins | PartData | PartEnds


class _Listener:
    """Turns the parser's callbacks into a list of events."""

    def __init__(self) -> None:
        self.events: list[FormEvent] = []
        self.complete = False
        self._parts = 0
        self._header = b""
        self._value = b""
        self._disposition = b""

    def callbacks(self) -> MultipartCallbacks:
        return {
            "on_part_begin": self._part_begin,
            "on_header_field": self._header_field,
            "on_header_value": self._header_value,
            "on_header_end": self._header_end,
            "on_headers_finished": self._headers_finished,
            "on_part_data": self._part_data,
            "on_part_end": lambda: self.events.append(PartEnds()),
            "on_end": self._end,
        }

    def _part_begin(self) -> None:
        self._parts += 1
        if self._parts > MOST_PARTS:
            raise _malformed(f"the form has more than {MOST_PARTS} parts")
        self._disposition = b""

    def _header_field(self, data: bytes, start: int, end: int) -> None:
        self._header += data[start:end]

    def _header_value(self, data: bytes, start: int, end: int) -> None:
        self._value += data[start:end]

    def _header_end(self) -> None:
        if self._header.lower() == b"content-disposition":
            self._disposition = self._value
        self._header = self._value = b""

    def _headers_finished(self) -> None:
        kind, parameters = parse_options_header(self._disposition)
        if kind != b"form-data" or b"name" not in parameters:
            raise _malformed("a part of the form has no name")
        filename = parameters.get(b"filename")
        self.events.append(
            PartBegins(
                parameters[b"name"].decode("utf-8", "replace"),
                None if filename is None else filename.decode("utf-8", "replace"),
            )
        )

    def _part_data(self, data: bytes, start: int, end: int) -> None:
        self.events.append(PartData(bytes(data[start:end])))

    def _end(self) -> None:
        self.complete = True


async def form_events(content_type: str, chunks: AsyncIterator[bytes]) -> AsyncIterator[FormEvent]:
    """The events of a multipart/form-data body; raises Problem if it is not one."""
    kind, parameters = parse_options_header(content_type)
    if kind != b"multipart/form-data":
        raise Problem(
            "request.media_type",
            f"the body is {kind.decode('latin-1') or 'of no stated type'}",
            where="Content-Type",
            advice="Send multipart/form-data with a part named file.",
        )
    listener = _Listener()
    try:
        parser = MultipartParser(parameters.get(b"boundary", b""), listener.callbacks())
        async for chunk in chunks:
            if chunk:
                parser.write(chunk)
            for event in listener.events:
                yield event
            listener.events.clear()
        parser.finalize()
    except FormParserError as error:
        raise _malformed(str(error)) from error
    if not listener.complete:
        raise _malformed("the form ends before its last boundary")


def _malformed(detail: str) -> Problem:
    return Problem(
        "request.malformed", detail, advice="Send multipart/form-data as RFC 7578 has it."
    )
