"""Text clouds: one point per line, in the dialects of .xyz, .txt, .csv, .pts, .asc and .pwn."""

from __future__ import annotations

from dataclasses import replace
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from mpf_core.cloud.attributes import colors_to_uint8, unit_normals
from mpf_core.cloud.columns import COLORS, COORDINATES, NORMALS, meaning_of, roles_of
from mpf_core.cloud.limits import DEFAULT_LIMITS, HEADER_BYTES, Limits
from mpf_core.cloud.pointcloud import PointCloud
from mpf_core.cloud.reading import Column, Reading, describe_columns
from mpf_core.cloud.textrows import BLOCK_BYTES, line_blocks, parse_block
from mpf_core.cloud.xyzhead import TextHead, count_mismatch, read_head
from mpf_core.cloud.xyzroles import Roles, are_unit_vectors, counts_up, guess_roles
from mpf_core.errors import TooLarge

_EXTRAS = 9  # unnamed columns beside the coordinates that are looked at
_SCALARS = ("intensity", "alpha", "opacity")


def read_xyz(stream: BinaryIO, size: int, limits: Limits = DEFAULT_LIMITS) -> Reading:
    """The text cloud in `stream`, which is `size` bytes long."""
    stream.seek(0)
    head = read_head(stream.read(HEADER_BYTES), size, limits)
    if head.names is not None:
        roles = _named_roles(head.names)
    else:
        roles = Roles(dict(zip(COORDINATES, range(3), strict=True)))
    kept = _kept_columns(head, roles)
    points, extras = _read_rows(stream, head, roles, kept, limits)
    if head.declared is not None and len(points) != head.declared:
        halves = _points_then_normals(head, points)
        if halves is not None:
            return halves
        head, points, extras = _as_declared(head, head.declared, points, extras)
    if head.names is None:
        roles = guess_roles(extras, head.columns)
        if head.columns > 3 and counts_up(points[:, 0]):
            said = "column 1 counts the rows; if it is not x, a header x, y, z would say so"
            roles = replace(roles, warnings=(*roles.warnings, said))
    return _assemble(head, roles, points, extras, kept)


def _named_roles(names: tuple[str, ...]) -> Roles:
    found = roles_of(names)
    wanted = dict(found)
    warnings = []
    for triple, what in ((NORMALS, "normals"), (COLORS, "colours")):
        present = [role for role in triple if role in found]
        if present and len(present) < len(triple):
            warnings.append(f"the header names only {', '.join(present)}: no {what} are read")
        if len(present) < len(triple):
            for role in present:
                del wanted[role]
    return Roles(wanted, warnings=tuple(warnings))


def _kept_columns(head: TextHead, roles: Roles) -> list[int]:
    """Columns beside the coordinates that have to be held until the end."""
    if head.names is None:
        return list(range(3, min(head.columns, 3 + _EXTRAS)))
    return [roles.index[role] for role in (*NORMALS, *COLORS) if role in roles.index]


def _read_rows(
    stream: BinaryIO, head: TextHead, roles: Roles, kept: list[int], limits: Limits
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Coordinates (n, 3) and the kept columns (n, k)."""
    # The number of lines bounds the number of rows, so the arrays are made once and never grown.
    most = min(_count_lines(stream, head.offset), limits.max_points)
    points = np.empty((most, 3))
    extras = np.empty((most, len(kept)))
    axes = [roles.index[axis] for axis in COORDINATES]
    n = 0
    for block in line_blocks(stream, head.offset, head.line, head.style, limits.max_line_bytes):
        table = parse_block(block, head.columns, head.style)
        if n + len(table) > most:
            raise TooLarge(
                f"the file holds more than {limits.max_points} points",
                where=f"after line {block.line}",
                advice="Thin the cloud, or reconstruct it in parts.",
            )
        points[n : n + len(table)] = table[:, axes]
        extras[n : n + len(table)] = table[:, kept]
        n += len(table)
    points.resize((n, 3), refcheck=False)
    extras.resize((n, len(kept)), refcheck=False)
    return points, extras


def _count_lines(stream: BinaryIO, offset: int) -> int:
    stream.seek(offset)
    feeds = returns = 0
    while piece := stream.read(BLOCK_BYTES):
        feeds += piece.count(b"\n")
        returns += piece.count(b"\r")
    return feeds + returns + 1


def _as_declared(
    head: TextHead, declared: int, points: NDArray[np.float64], extras: NDArray[np.float64]
) -> tuple[TextHead, NDArray[np.float64], NDArray[np.float64]]:
    """No more rows than the leading count says, as other readers of PTS have it."""
    if len(points) < declared:
        raise count_mismatch(declared, f"{len(points)} rows follow")
    said = f"the first line declares {declared} points: {len(points) - declared} rows after them "
    head = replace(head, warnings=(*head.warnings, said + "are left out"))
    return head, points[:declared].copy(), extras[:declared].copy()


def _points_then_normals(head: TextHead, rows: NDArray[np.float64]) -> Reading | None:
    """The older .pwn layout: the count n, then n rows of points, then n rows of normals."""
    n = head.declared or 0
    if head.columns != 3 or len(rows) != 2 * n or not are_unit_vectors(rows[n:]):
        return None
    normals, notes = unit_normals(rows[n:])
    notes.append(f"the first {n} rows read as points, the next {n} as their normals")
    cloud = PointCloud(points=rows[:n].copy(), normals=normals, notes=tuple(notes))
    columns = tuple(Column(f"column {i + 1}", f"{a}, then normal {a}") for i, a in enumerate("xyz"))
    return Reading(cloud, "xyz", f"{head.dialect}, points then normals", columns, head.warnings)


def _assemble(
    head: TextHead,
    roles: Roles,
    points: NDArray[np.float64],
    extras: NDArray[np.float64],
    kept: list[int],
) -> Reading:
    notes = list(roles.notes)
    warnings = [*head.warnings, *roles.warnings]
    place = {column: i for i, column in enumerate(kept)}
    normals = colors = None
    if all(role in roles.index for role in NORMALS):
        normals, said = unit_normals(_triple(extras, [place[roles.index[r]] for r in NORMALS]))
        notes += said
    if all(role in roles.index for role in COLORS):
        values = _triple(extras, [place[roles.index[r]] for r in COLORS])
        whole = bool(np.array_equal(values, np.rint(values))) and float(values.max(initial=0)) > 1
        colors, scale, guessed = colors_to_uint8(values, whole=whole)
        said_color = f"colours {'are' if colors is None else 'read on the scale'} {scale}"
        if colors is None:
            warnings.append(f"{said_color}: no known scale, left out")
        else:
            (warnings if guessed else notes).append(said_color)
    columns = _columns(head, roles)
    notes.insert(0, f"columns: {describe_columns(columns)}")
    cloud = PointCloud(points, normals, colors, notes=(*notes, *warnings))
    return Reading(cloud, "xyz", head.dialect, columns, tuple(warnings))


def _triple(extras: NDArray[np.float64], places: list[int]) -> NDArray[np.float64]:
    """Three of the columns, without a copy where they lie side by side."""
    if places == list(range(places[0], places[0] + 3)):
        return extras[:, places[0] : places[0] + 3]
    return extras[:, places]


def _columns(head: TextHead, roles: Roles) -> tuple[Column, ...]:
    meanings = {index: meaning_of(role) for role, index in roles.index.items()}
    for role in _SCALARS:
        if role in roles.index:
            meanings[roles.index[role]] = f"{role} (left out)"
    names = head.names or tuple(f"column {i + 1}" for i in range(head.columns))
    return tuple(Column(name, meanings.get(i, "left out")) for i, name in enumerate(names))
