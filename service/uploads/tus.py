"""The tus protocol, version 1.0.0 (https://tus.io/protocols/resumable-upload): creation,
termination, checksum, expiration."""

from __future__ import annotations

import base64
import binascii
from collections.abc import AsyncIterator
from email.utils import formatdate
from typing import Annotated, Any

import anyio
from anyio import to_thread
from fastapi import APIRouter, Depends, Header, Path, Request, Response
from starlette.requests import ClientDisconnect

from mpf_core.cloud.errors import error_codes
from service.access.dependency import CallerDep
from service.problems import Problem
from service.responses import problems
from service.state import State, StateDep
from service.uploads.incoming import Checksum, Upload, Writer, too_many
from service.uploads.sink import too_large

router = APIRouter(tags=["uploads"], prefix="/uploads")

VERSION = "1.0.0"
EXTENSIONS = "creation,termination,checksum,expiration"
ALGORITHMS = ("sha1", "sha256")
PIECE_TYPE = "application/offset+octet-stream"
LONGEST_METADATA = 4096

# What pages of other origins may send and read.
ALLOWED_HEADERS = (
    "Tus-Resumable", "Upload-Length", "Upload-Offset", "Upload-Metadata", "Upload-Checksum",
)  # fmt: skip
EXPOSED_HEADERS = (
    "Tus-Resumable", "Tus-Version", "Tus-Max-Size", "Tus-Extension", "Upload-Length",
    "Upload-Offset", "Upload-Expires", "Upload-Metadata",
)  # fmt: skip

IDLE_SECONDS = 30.0
"""A sender that says nothing for this long is taken for lost, so that it may come back."""

UploadId = Annotated[str, Path(description="As POST /uploads gave it.", max_length=64)]


async def speaks_tus(
    tus_resumable: Annotated[str, Header(description="The protocol's version: 1.0.0.")] = "",
) -> None:
    """Refuse who speaks another version, as the protocol asks."""
    if tus_resumable != VERSION:
        raise Problem(
            "upload.version", "Tus-Resumable is not 1.0.0", where="Tus-Resumable",
            advice="Send Tus-Resumable: 1.0.0.",
        )  # fmt: skip


_SPOKEN = [Depends(speaks_tus)]
_HEADERS = {"Tus-Resumable": VERSION, "Cache-Control": "no-store"}
_FOUND = problems("upload.not_found", "upload.version", "request.invalid")


def _headers(*names: str) -> dict[str, Any]:
    """What a successful answer tells in its header, and nowhere else."""
    return {"headers": {name: {"schema": {"type": "string"}, "required": True} for name in names}}


@router.options(
    "",
    status_code=204,
    response_class=Response,
    responses={204: _headers("Tus-Version", "Tus-Extension", "Tus-Max-Size")},
)
def discover(state: StateDep) -> Response:
    """Which parts of the protocol are spoken here."""
    told = {
        "Tus-Version": VERSION,
        "Tus-Extension": EXTENSIONS,
        "Tus-Checksum-Algorithm": ",".join(ALGORITHMS),
        "Tus-Max-Size": str(state.settings.upload_bytes),
    }
    return Response(status_code=204, headers=_HEADERS | told)


@router.post(
    "",
    status_code=201,
    response_class=Response,
    dependencies=_SPOKEN,
    responses=problems("upload.version", "request.invalid", "storage.full")
    | {201: _headers("Location", "Upload-Offset", "Upload-Expires")},
)
async def create(
    caller: CallerDep,
    state: StateDep,
    upload_length: Annotated[int, Header(ge=0, description="Of the whole file, bytes.")],
    upload_metadata: Annotated[
        str, Header(max_length=LONGEST_METADATA, description="`filename` and base64 of it.")
    ] = "",
) -> Response:
    """Begin an upload; its bytes follow by PATCH, and `POST /jobs` makes a job of it."""
    if upload_length > state.settings.upload_bytes:
        raise too_large(state.settings.upload_bytes)
    name = filename_in(upload_metadata)
    upload = await to_thread.run_sync(
        state.resumable.create, caller.owner, upload_length, name, upload_metadata
    )
    headers = await to_thread.run_sync(_told, state, upload)
    return Response(status_code=201, headers=headers | {"Location": f"/uploads/{upload.id}"})


@router.head(
    "/{upload_id}",
    response_class=Response,
    dependencies=_SPOKEN,
    responses=_FOUND | {200: _headers("Upload-Length", "Upload-Offset", "Upload-Expires")},
)
def where(upload_id: UploadId, caller: CallerDep, state: StateDep) -> Response:
    """How much of the upload has arrived."""
    upload = state.resumable.get(caller.owner, upload_id)
    about = {"Upload-Length": str(upload.length)}
    if upload.metadata:
        about["Upload-Metadata"] = upload.metadata
    return Response(headers=_told(state, upload) | about)


@router.patch(
    "/{upload_id}",
    status_code=204,
    response_class=Response,
    dependencies=_SPOKEN,
    openapi_extra={
        "requestBody": {"required": True, "content": {PIECE_TYPE: {"schema": {"type": "string"}}}}
    },
    responses=problems(
        "upload.not_found",
        "upload.version",
        "upload.offset",
        "upload.locked",
        "upload.checksum",
        "request.invalid",
        "request.media_type",
        "storage.full",
        *error_codes(),
    )
    | {204: _headers("Upload-Offset", "Upload-Expires")},
)
async def append(
    upload_id: UploadId,
    request: Request,
    caller: CallerDep,
    state: StateDep,
    upload_offset: Annotated[int, Header(ge=0, description="Where the piece begins.")],
    upload_checksum: Annotated[
        str, Header(max_length=200, description="`sha1` or `sha256`, and base64 of the digest.")
    ] = "",
) -> Response:
    """Take the next piece; if the connection is lost, what has come of it counts."""
    if request.headers.get("content-type", "").partition(";")[0].strip() != PIECE_TYPE:
        raise Problem("request.media_type", f"a piece is not {PIECE_TYPE}", where="Content-Type")
    checksum = checksum_in(upload_checksum)
    upload = await to_thread.run_sync(state.resumable.get, caller.owner, upload_id)
    announced = request.headers.get("content-length", "0")
    if announced.isdigit() and upload_offset + int(announced) > upload.length:
        raise too_many()
    writer = await to_thread.run_sync(state.resumable.begin, upload, upload_offset, checksum)
    try:
        await _take(writer, request.stream())
        await to_thread.run_sync(writer.finish)
    finally:
        # Also when this request is cancelled: the lock must go, and what has come must stay.
        with anyio.CancelScope(shield=True):
            await to_thread.run_sync(writer.close)
    await to_thread.run_sync(state.resumable.judge, upload, upload_offset)
    return Response(status_code=204, headers=await to_thread.run_sync(_told, state, upload))


@router.delete(
    "/{upload_id}",
    status_code=204,
    response_class=Response,
    dependencies=_SPOKEN,
    responses=_FOUND,
)
def terminate(upload_id: UploadId, caller: CallerDep, state: StateDep) -> Response:
    """Give the upload up."""
    state.resumable.remove(state.resumable.get(caller.owner, upload_id))
    return Response(status_code=204, headers=_HEADERS)


def filename_in(metadata: str) -> str:
    """The file's name in `Upload-Metadata`; raises Problem if that cannot be read."""
    for pair in filter(None, (part.strip() for part in metadata.split(","))):
        key, _, value = pair.partition(" ")
        if key == "filename":
            return _decoded(value, "Upload-Metadata").decode("utf-8", "replace")
    return ""


def checksum_in(header: str) -> Checksum | None:
    """What `Upload-Checksum` says; raises Problem if that cannot be read."""
    if not header:
        return None
    algorithm, _, digest = header.partition(" ")
    if algorithm not in ALGORITHMS:
        raise Problem(
            "request.invalid", "the checksum's algorithm is not known", where="Upload-Checksum",
            advice=f"Use one of {', '.join(ALGORITHMS)}.",
        )  # fmt: skip
    return Checksum(algorithm, _decoded(digest, "Upload-Checksum"))


def _decoded(text: str, where: str) -> bytes:
    try:
        return base64.b64decode(text.strip(), validate=True)
    except (binascii.Error, ValueError) as error:
        raise Problem("request.invalid", f"{where} is not base64", where=where) from error


async def _take(writer: Writer, chunks: AsyncIterator[bytes]) -> None:
    """Write each chunk as it comes, so that what has come counts whatever happens next."""
    while True:
        try:
            with anyio.fail_after(IDLE_SECONDS):
                chunk = await anext(chunks, None)
        except TimeoutError as error:
            raise ClientDisconnect from error
        if chunk is None:
            return
        await to_thread.run_sync(writer.write, chunk)


def _told(state: State, upload: Upload) -> dict[str, str]:
    return _HEADERS | {
        "Upload-Offset": str(state.resumable.offset(upload)),
        "Upload-Expires": formatdate(state.resumable.expires_at(upload), usegmt=True),
    }
