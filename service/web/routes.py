"""GET / and /assets/{name}: the browser client as it was built, under a strict policy.

The files are the same for everybody and say nothing of anybody's jobs, so no key is asked for; what
the page then requests is answered like everything else.
"""

from __future__ import annotations

import re
from mimetypes import types_map
from pathlib import Path

from fastapi import APIRouter, Request, Response
from fastapi.responses import FileResponse

from service.problems import Problem

STATIC = Path(__file__).parent / "static"
"""Written by scripts/web.py: index.html, assets/, and each text compressed beside itself."""

POLICY = "; ".join((
    "default-src 'none'",
    "script-src 'self'",
    "style-src 'self'",
    "img-src 'self' blob:",  # pictures that were fetched with a key
    "connect-src 'self'",
    "worker-src 'self'",
    "base-uri 'none'",
    "form-action 'none'",
    "frame-ancestors 'none'",
))  # fmt: skip

HEADERS = {
    "Content-Security-Policy": POLICY,
    "Cross-Origin-Opener-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}

FOREVER = "public, max-age=31536000, immutable"  # an asset's name changes with its content
_NAME = re.compile(r"[\w-]+\.[\w-]+\.?\w+")
_TYPES = types_map | {".js": "text/javascript", ".svg": "image/svg+xml"}

router = APIRouter(include_in_schema=False)


@router.api_route("/", methods=["GET", "HEAD"])
def page(request: Request) -> Response:
    """The page; which job it shows stands behind the # and is never sent."""
    return _file("index.html", request, "no-cache")


@router.api_route("/assets/{name}", methods=["GET", "HEAD"])
def asset(name: str, request: Request) -> Response:
    """A script, style sheet or picture of the page."""
    if not _NAME.fullmatch(name):
        raise Problem("not_found", f"there is no asset {name!r}")
    return _file(f"assets/{name}", request, FOREVER)


def _file(name: str, request: Request, keep: str) -> Response:
    path = STATIC / name
    if not path.is_file():
        raise Problem(
            "not_found", "the browser client is not built, or is of another version",
            advice="Reload the page. In a checkout, scripts/setup builds it.",
        )  # fmt: skip
    headers = HEADERS | {"Cache-Control": keep, "Vary": "Accept-Encoding"}
    packed = path.with_name(path.name + ".gz")
    if "gzip" in request.headers.get("accept-encoding", "") and packed.is_file():
        headers["Content-Encoding"] = "gzip"
    else:
        packed = path
    media_type = _TYPES.get(path.suffix, "application/octet-stream")
    return FileResponse(packed, headers=headers, media_type=media_type)
