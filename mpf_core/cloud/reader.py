"""The front of the readers: which format a file is in, and its cloud."""

from __future__ import annotations

import os
import re
import stat
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from mpf_core.cloud.errors import FormatUnknown, InputEmpty, InputTooLarge, InputUnreadable
from mpf_core.cloud.limits import DEFAULT_LIMITS, HEADER_BYTES, MINIMUM_POINTS, Limits
from mpf_core.cloud.ply import read_ply
from mpf_core.cloud.plyheader import parse_header
from mpf_core.cloud.pointcloud import PointCloud
from mpf_core.cloud.reading import Reading
from mpf_core.cloud.xyz import read_xyz
from mpf_core.cloud.xyzhead import UTF8_MARK, read_head
from mpf_core.errors import TooSmall

TEXT_SUFFIXES = (".xyz", ".txt", ".csv", ".pts", ".asc", ".pwn")
SUFFIXES = (".ply", *TEXT_SUFFIXES)

# Formats that are often uploaded by mistake: the answer names them.
_FOREIGN = (
    (b"# .PCD", "PCD (Point Cloud Library)"),
    (b"LASF", "LAS or LAZ"),
    (b"ASTM-E57", "E57"),
    (b"glTF", "GLB"),
    (b"solid ", "STL"),
    (b"OFF", "OFF"),
    (b"COFF", "OFF"),
    (b"NOFF", "OFF"),
    (b"mtllib ", "OBJ"),
    (b"# vtk ", "VTK"),
    (b"VERSION ", "PCD (Point Cloud Library)"),
    (b"ncols", "an ESRI grid"),
    (b"NCOLS", "an ESRI grid"),
    (b"DSAA", "a Surfer grid"),
    (b"PK\x03\x04", "a ZIP archive"),
    (b"\x1f\x8b", "a gzip file"),
    (b"{", "JSON"),
    (b"<", "XML or HTML"),
    (b"%PDF", "PDF"),
)
_OBJ_VERTEX = re.compile(rb"^v[ \t]+[-+.\d]", re.MULTILINE)


@dataclass(frozen=True)
class HeaderFacts:
    """What the first bytes of a file tell.

    format: "ply" or "xyz"
    declared_points: the count in the header, or None where there is none
    complete: False if more bytes are needed; then nothing has been checked yet
    """

    format: str
    declared_points: int | None
    complete: bool


def read_cloud(path: str | os.PathLike[str], *, limits: Limits = DEFAULT_LIMITS) -> PointCloud:
    """The point cloud in a file, in its own units and frame; what was decided is in its notes.

    Raises a FormatError of `mpf_core.cloud.errors` that says what is wrong and where, or TooLarge.
    Coordinates that are not finite are left to `prepare`.
    """
    return read(path, limits=limits).cloud


def read(path: str | os.PathLike[str], *, limits: Limits = DEFAULT_LIMITS) -> Reading:
    """The cloud in a file with the reader's account of it."""
    try:
        # Without O_NONBLOCK the mere opening of a pipe would wait for a writer.
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
        with os.fdopen(descriptor, "rb") as stream:
            about = os.fstat(stream.fileno())
            if not stat.S_ISREG(about.st_mode):
                raise InputUnreadable(
                    "the input is not a regular file",
                    where=Path(path).name,
                    advice="Give the path of a file.",
                )
            return read_stream(stream, about.st_size, limits=limits)
    except OSError as error:
        raise InputUnreadable(
            f"the file cannot be read: {error.strerror or 'input error'}",
            where=Path(path).name,
            advice="Check the path and its permissions.",
        ) from None


def read_stream(stream: BinaryIO, size: int, *, limits: Limits = DEFAULT_LIMITS) -> Reading:
    """The cloud in a seekable stream of `size` bytes."""
    stream.seek(0)
    first = stream.read(HEADER_BYTES)
    if format_of(first, size, limits) == "ply":
        return read_ply(stream, size, limits)
    return read_xyz(stream, size, limits)


def peek_header(
    first: bytes, total_size: int | None, *, limits: Limits = DEFAULT_LIMITS
) -> HeaderFacts:
    """What the first bytes of a file tell, before the rest has arrived.

    first: the first HEADER_BYTES of the file, or all of it
    total_size: bytes of the whole file, or None if not yet known

    Raises what reading the whole file would raise for its header: a wrong format, counts that the
    file cannot hold, too many points. A count that is too small is refused here too.
    """
    kind = format_of(first, total_size, limits)
    if kind == "ply":
        header = parse_header(first, total_size, limits)
        if header is None:
            return HeaderFacts("ply", None, complete=False)
        declared: int | None = header.vertex.count
    elif len(first) < HEADER_BYTES and (total_size is None or len(first) < total_size):
        return HeaderFacts("xyz", None, complete=False)
    else:
        declared = read_head(first, total_size, limits).declared
    if declared is not None and declared < MINIMUM_POINTS:
        raise TooSmall(
            f"the header declares {declared} points",
            where="header",
            advice=f"A surface needs at least {MINIMUM_POINTS} distinct points.",
        )
    return HeaderFacts(kind, declared, complete=True)


def format_of(first: bytes, total_size: int | None, limits: Limits = DEFAULT_LIMITS) -> str:
    """Either "ply" or "xyz", by content: the name has no say, so a wrong one does no harm."""
    if not first and not total_size:
        raise InputEmpty("the file is empty", advice="Upload a file with points in it.")
    if total_size is not None and total_size > limits.max_bytes:
        raise InputTooLarge(
            f"the file has {total_size} bytes, more than {limits.max_bytes}",
            advice="Thin the cloud, or reconstruct it in parts.",
        )
    if is_ply(first):
        return "ply"
    for mark, name in _FOREIGN:
        if first.startswith(mark) or (name == "OBJ" and _OBJ_VERTEX.search(first)):
            raise FormatUnknown(
                f"the file looks like {name}, which is not read",
                where="byte 0",
                advice="Convert it to PLY or to text rows x y z.",
            )
    return "xyz"


def is_ply(first: bytes) -> bool:
    """Whether the first line is `ply` and nothing else; some editors put a UTF-8 mark before it."""
    first = first.removeprefix(UTF8_MARK)
    return first[:3] == b"ply" and (len(first) == 3 or first[3:4] in b" \t\r\n")
