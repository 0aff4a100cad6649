"""What schemathesis cannot make up: a cloud, ids of what exists, valid keys, pieces that fit.

Loaded by `schemathesis run` (SCHEMATHESIS_HOOKS); see test_schemathesis.py.
"""

from __future__ import annotations

import os
import random
from typing import Any

import schemathesis

from service.uploads.tus import PIECE_TYPE
from tests.services import sphere_xyz

CHANCE = random.Random(5)  # noqa: S311
CLOUD = sphere_xyz()
TOKEN = os.environ["MPF_TEST_TOKEN"]
KNOWN: dict[str, list[str]] = {"job_id": [], "upload_id": [], "token": [], "share_id": []}
FILES = ("mesh.glb", "mesh.ply", "report.json", "slices/x/0.png", "preview.glb", "input.xyz")
LONGEST_WAIT = 0.2  # s; a long poll of a minute teaches nothing more


@schemathesis.serializer(PIECE_TYPE, "application/octet-stream")
def bytes_of(_context: Any, value: Any) -> bytes:
    return value if isinstance(value, bytes) else str(value).encode()


def likely(share: float) -> bool:
    return CHANCE.random() < share


@schemathesis.hook
def before_call(_context: Any, case: Any, _kwargs: dict[str, Any]) -> None:
    """Make most requests such that they get past the door."""
    case.headers = headers = case.headers if case.headers is not None else {}
    case.query = query = case.query if case.query is not None else {}
    label = case.operation.label
    if label.startswith("GET ") and likely(0.3):
        headers["Range"] = CHANCE.choice(["bytes=0-3", "bytes=-2,0-1", "bytes=99999999-", "x"])
    if str(query.get("wait", "")).replace(".", "", 1).isdigit() and float(query["wait"]) <= 60:
        query["wait"] = min(float(query["wait"]), LONGEST_WAIT)
    if case.operation.path.startswith("/uploads") and likely(0.8):
        headers["Tus-Resumable"] = "1.0.0"
    _name_what_exists(case)
    if label in MENDED and likely(0.6):
        MENDED[label](case)


def _name_what_exists(case: Any) -> None:
    given = case.path_parameters or {}
    for name, ids in KNOWN.items():
        if ids and name in given and likely(0.6):
            # Streams of events last as long as the job: one of those that came first has ended.
            streams = case.operation.path.endswith("/events")
            given[name] = CHANCE.choice(ids[:2] if streams else ids[-5:])
    if "name" in given and likely(0.8):
        given["name"] = CHANCE.choice(FILES)


def _submission(case: Any) -> None:
    case.media_type = case.headers["Content-Type"] = "application/octet-stream"
    case.body = CLOUD
    case.query = {"name": CHANCE.choice(("ok.xyz", "line.xyz"))}


def _piece(case: Any) -> None:
    case.media_type = case.headers["Content-Type"] = PIECE_TYPE
    case.headers["Upload-Offset"] = "0"
    case.headers.pop("Upload-Checksum", None)
    case.body = CLOUD


def _upload(case: Any) -> None:
    case.headers["Upload-Length"] = str(len(CLOUD))
    case.headers.pop("Upload-Metadata", None)


MENDED = {
    "POST /jobs": _submission,
    "PATCH /uploads/{upload_id}": _piece,
    "POST /uploads": _upload,
}


@schemathesis.hook
def after_call(_context: Any, case: Any, response: Any) -> None:
    """Remember what exists."""
    place = response.headers.get("location", [""])[0]
    for prefix, name in (("/jobs/", "job_id"), ("/uploads/", "upload_id")):
        if response.status_code in (201, 202) and place.startswith(prefix):
            KNOWN[name].append(place.removeprefix(prefix))
    if response.status_code == 201 and case.operation.path.endswith("/shares"):
        share = response.json()
        KNOWN["token"].append(share["href"].removeprefix("/shared/"))
        KNOWN["share_id"].append(share["id"])
