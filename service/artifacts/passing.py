"""Files that lie in an object store: by a link to it, or passed on by the API."""

from __future__ import annotations

import re
from collections.abc import Mapping

from fastapi import Request, Response
from fastapi.responses import RedirectResponse, StreamingResponse

from service.artifacts.base import Blob
from service.problem_handlers import respond
from service.problems import Problem

_RANGE = re.compile(r"bytes=(\d*)-(\d*)")


def wants_link(request: Request) -> bool:
    """Whether the caller can follow a redirect to another origin.

    Scripts, pictures and models of a web page cannot (the page's policy and the store's own rules
    forbid it). Browsers tell by Sec-Fetch-Dest who asks, but only over HTTPS and to this machine;
    so the scripts of our own page say themselves that they want the file here (RFC 7240).
    """
    if "return=representation" in request.headers.get("prefer", ""):
        return False
    return request.headers.get("sec-fetch-dest", "document") == "document"


def linked(link: str, headers: Mapping[str, str]) -> Response:
    """Send the caller to the store; the link lapses, so it is not kept."""
    return RedirectResponse(link, 307, headers=dict(headers) | {"Cache-Control": "no-store"})


def passed(blob: Blob, request: Request, headers: Mapping[str, str], media_type: str) -> Response:
    """The bytes through this process, all or one range of them (several: all)."""
    told = dict(headers) | {"Accept-Ranges": "bytes"}
    wanted = request.headers.get("range", "")
    if request.headers.get("if-range", told.get("ETag")) != told.get("ETag"):
        wanted = ""
    found = _RANGE.fullmatch(wanted.strip())
    if found is None or found.groups() == ("", ""):
        return _stream(blob, 0, blob.size, 200, told, media_type)
    start, stop = _bounds(found[1], found[2], blob.size)
    if start >= stop:
        problem = Problem("request.range", "the file has no such range", where="Range")
        return respond(problem, request, {"Content-Range": f"bytes */{blob.size}"})
    told["Content-Range"] = f"bytes {start}-{stop - 1}/{blob.size}"
    return _stream(blob, start, stop, 206, told, media_type)


def _bounds(first: str, last: str, size: int) -> tuple[int, int]:
    """From where to before where; empty where the file has no such bytes."""
    if not first:  # the last so many
        return max(0, size - int(last)), size if int(last) else 0
    return int(first), min(size, int(last) + 1) if last else size


def _stream(
    blob: Blob, start: int, stop: int, status: int, headers: dict[str, str], media_type: str
) -> Response:
    length = {"Content-Length": str(stop - start)}
    return StreamingResponse(
        blob.read(start, stop), status, headers=headers | length, media_type=media_type
    )
