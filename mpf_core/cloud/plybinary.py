"""The body of a binary PLY file, read in pieces so that no more than the cloud is ever held."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, BinaryIO, Literal

import numpy as np
from numpy.typing import NDArray

from mpf_core.cloud.errors import PlyCountMismatch, PlyListLength
from mpf_core.cloud.plyschema import Element, PlyHeader
from mpf_core.errors import FormatError

_PIECE_BYTES = 4 * 1024 * 1024
_ROWS_ONE_BY_ONE = 65_536  # walked at once where lists differ in length from row to row
_SHORT_RUN = 64  # rows of equal layout below which walking is faster than slicing

Targets = Mapping[int, NDArray[Any]]
"""Index of a vertex property → the (n,) array that its values go to."""


def read_binary(stream: BinaryIO, size: int, header: PlyHeader, targets: Targets) -> int:
    """Fills the targets; returns the number of bytes after the last element."""
    offset = header.body
    for element in header.elements:
        body = _Body(stream, size, header.order, element)
        wanted = targets if element is header.vertex else {}
        if element.has_lists:
            offset = _take_lists(body, offset, wanted)
        else:
            offset = _take_fixed(body, offset, wanted)
    return size - offset


@dataclass
class _Body:
    """One element's part of the file, and the piece of it that is in memory."""

    stream: BinaryIO
    size: int
    order: str
    element: Element
    piece: bytes = b""
    start: int = 0

    def load(self, offset: int, needed: int) -> int:
        """Makes `needed` bytes at `offset` available; returns their place in `piece`."""
        if offset + needed > self.size:
            raise self.cut_off()
        at = offset - self.start
        if at < 0 or at + needed > len(self.piece):
            self.stream.seek(offset)
            self.piece = self.stream.read(max(needed, _PIECE_BYTES))
            self.start, at = offset, 0
            if len(self.piece) < needed:
                raise self.cut_off()
        return at

    def cut_off(self) -> FormatError:
        return PlyCountMismatch(
            f"the data ends inside element {self.element.name[:24]!r}, "
            f"of which {self.element.count} rows are declared",
            where=f"byte {self.size}",
            advice="The file is cut off, or the counts in its header are wrong.",
        )


def _take_fixed(body: _Body, offset: int, targets: Targets) -> int:
    row = body.element.row_type(body.order)
    end = offset + body.element.count * row.itemsize
    if end > body.size:
        raise body.cut_off()
    if not targets or row.itemsize == 0:
        return end
    step = max(1, _PIECE_BYTES // row.itemsize)
    for first in range(0, body.element.count, step):
        n = min(step, body.element.count - first)
        at = body.load(offset + first * row.itemsize, n * row.itemsize)
        _store(np.frombuffer(body.piece, row, count=n, offset=at), first, targets)
    return end


def _store(rows: NDArray[np.void], first: int, targets: Targets) -> None:
    with np.errstate(invalid="ignore"):  # a signalling NaN is a NaN; preparation judges those
        for index, target in targets.items():
            target[first : first + len(rows)] = rows[f"f{index}"]


def _take_lists(body: _Body, offset: int, targets: Targets) -> int:
    """Rows with lists: runs of equal layout at once, the others one by one."""
    done, count = 0, body.element.count
    while done < count:
        lengths, row_bytes = _layout(body, offset)
        if row_bytes > _PIECE_BYTES:
            if targets or offset + row_bytes > body.size:
                raise body.cut_off()
            offset, done = offset + row_bytes, done + 1
            continue
        rows = _equal_rows(body, offset, lengths, row_bytes, count - done)
        if len(rows) >= _SHORT_RUN or done + len(rows) == count:
            _store(rows, done, targets)
            offset, done = offset + len(rows) * row_bytes, done + len(rows)
        elif not targets and _has_one_short_list(body.element):
            offset, done = _skip_quickly(body, offset, done)
        else:
            starts = _walk(body, offset, min(count - done, _ROWS_ONE_BY_ONE))
            _gather(body, starts, done, targets)
            offset, done = starts[-1], done + len(starts) - 1
    if offset > body.size:
        raise body.cut_off()
    return offset


def _layout(body: _Body, offset: int) -> tuple[tuple[int, ...], int]:
    """Lengths of the lists in the row at `offset`, and the row's size in bytes."""
    lengths: list[int] = []
    position = offset
    for p in body.element.properties:
        kind = np.dtype(body.order + (p.length or p.kind))
        if p.length is None:
            position += kind.itemsize
            continue
        at = body.load(position, kind.itemsize)
        n = int(np.frombuffer(body.piece, kind, count=1, offset=at)[0])
        _refuse_negative(n, position)
        lengths.append(n)
        position += kind.itemsize + n * np.dtype(p.kind).itemsize
    if position > body.size:
        raise body.cut_off()
    return tuple(lengths), position - offset


def _refuse_negative(length: int, position: int) -> None:
    if length < 0:
        raise PlyListLength(
            f"a list declares {length} values",
            where=f"byte {position}",
            advice="The data is damaged, or the header declares other types than it holds.",
        )


def _equal_rows(
    body: _Body, offset: int, lengths: tuple[int, ...], row_bytes: int, most: int
) -> NDArray[np.void]:
    """The rows from `offset` in this piece, up to the first one of another layout."""
    at = body.load(offset, row_bytes)
    n = min(most, (len(body.piece) - at) // row_bytes)
    rows = np.frombuffer(body.piece, body.element.row_type(body.order, lengths), n, at)
    lists = [i for i, p in enumerate(body.element.properties) if p.length is not None]
    # A short look first: in a file of mixed rows most runs end at once.
    for tried in (_SHORT_RUN, n):
        for i, length in zip(lists, lengths, strict=True):
            other = rows[f"n{i}"][:tried] != length
            if other.any():
                rows = rows[: int(other.argmax())]
        if len(rows) < min(tried, n):
            break
    return rows


def _has_one_short_list(element: Element) -> bool:
    return [p.length for p in element.properties if p.length is not None] == ["u1"]


def _skip_quickly(body: _Body, offset: int, done: int) -> tuple[int, int]:
    """Past the rows that start in this piece: faces, whose one list has a byte for its length."""
    ((before, _, _, item),), tail = _steps(body)
    piece, end = body.piece, len(body.piece) - before
    fixed = before + 1 + tail
    at = offset - body.start
    missing = body.element.count - done
    while missing and at < end:
        at += fixed + item * piece[at + before]
        missing -= 1
    return body.start + at, body.element.count - missing


def _walk(body: _Body, offset: int, most: int) -> list[int]:
    """Starts of up to `most` rows that lie in this piece, and the end of the last one."""
    steps, tail = _steps(body)
    order: Literal["big", "little"] = "big" if body.order == ">" else "little"
    piece, base = body.piece, body.start
    at, end = offset - base, len(piece)
    starts = [offset]
    for _ in range(most):
        for before, width, signed, item in steps:
            at += before
            if at + width > end:
                return starts
            if width == 1 and not signed:
                n = piece[at]
            else:
                n = int.from_bytes(piece[at : at + width], order, signed=signed)
                _refuse_negative(n, base + at)
            at += width + n * item
        at += tail
        if at > end:
            return starts
        starts.append(base + at)
    return starts


def _steps(body: _Body) -> tuple[list[tuple[int, int, bool, int]], int]:
    """Per list: (bytes before its length, the length's width, signed, bytes per value); tail."""
    steps, before = [], 0
    for p in body.element.properties:
        item = np.dtype(p.kind).itemsize
        if p.length is None:
            before += item
        else:
            steps.append((before, int(p.length[1]), p.length[0] == "i", item))
            before = 0
    return steps, before


def _gather(body: _Body, starts: list[int], first: int, targets: Targets) -> None:
    """The targets' values from rows of different sizes, counted from the row's nearer end."""
    if not targets:
        return
    edges = np.array(starts, dtype=np.int64) - body.start
    data = np.frombuffer(body.piece, np.uint8)
    for index, target in targets.items():
        kind = np.dtype(body.order + body.element.properties[index].kind)
        begin = _begin_of(body.element, index, edges)
        values = data[begin[:, None] + np.arange(kind.itemsize)]
        with np.errstate(invalid="ignore"):
            target[first : first + len(begin)] = values.view(kind)[:, 0]


def _begin_of(element: Element, index: int, edges: NDArray[np.int64]) -> NDArray[np.int64]:
    sizes = [np.dtype(p.kind).itemsize for p in element.properties]
    lists = [i for i, p in enumerate(element.properties) if p.length is not None]
    if index < lists[0]:
        return edges[:-1] + sum(sizes[:index])
    if index > lists[-1]:
        return edges[1:] - sum(sizes[index:])
    raise PlyListLength(
        f"property {element.properties[index].name[:24]!r} lies between lists of varying length",
        where=f"line {element.line}",
        advice="Export the points without lists.",
    )
