"""The header of a PLY file: parsed strictly, and checked against the file's size."""

from __future__ import annotations

import re
from collections.abc import Iterator

from mpf_core.cloud.columns import COORDINATES, roles_of
from mpf_core.cloud.errors import (
    PlyCountMismatch,
    PlyElementCount,
    PlyElementDuplicate,
    PlyFormatMissing,
    PlyFormatUnsupported,
    PlyHeaderLine,
    PlyHeaderTooLong,
    PlyHeaderTruncated,
    PlyPropertyDuplicate,
    PlyPropertyType,
    PlyTooManyRows,
    PlyVertexCoordinates,
)
from mpf_core.cloud.limits import HEADER_BYTES, Limits
from mpf_core.cloud.plyschema import Element, PlyHeader, Property
from mpf_core.errors import FormatError, TooLarge

# Both generations of names: Turk's own, and those with the width in them.
_KINDS = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4",
    "float": "f4", "double": "f8",
    "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "int64": "i8", "uint64": "u8", "float32": "f4", "float64": "f8",
    "bool": "u1",  # pyntcloud's, for the columns of a table
}  # fmt: skip
_BYTE_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_NO_COMMENT = "Created by Blender3D"  # Blender 2.47 left out the word `comment`
_LARGEST_COUNT = 2**32 - 1


def parse_header(first: bytes, total_size: int | None, limits: Limits) -> PlyHeader | None:
    """The header in the first bytes of a file; None if more bytes are needed to tell.

    total_size: bytes of the whole file, or None if not yet known.
    """
    complete = total_size is not None and total_size <= len(first)
    newline = _newline_of(first)
    state = _Parsing(first, newline)
    for number, text in state.lines(complete):
        if _take_line(state, number, text):
            header = PlyHeader(
                state.encoding or "",
                _BYTE_ORDERS[state.encoding or "ascii"],
                tuple(state.elements),
                state.offset,
                number,
                newline,
            )
            _check(header, total_size, limits)
            return header
    if complete and state.encoding is None and state.number > 1:
        raise _format_missing(f"line {state.number}")
    if complete:
        raise PlyHeaderTruncated(
            "the header ends without `end_header`",
            where=f"line {state.number}",
            advice="The file is cut off: export or upload it again.",
        )
    if len(first) >= HEADER_BYTES:
        raise PlyHeaderTooLong(
            f"there is no `end_header` in the first {HEADER_BYTES} bytes",
            where=f"line {state.number}",
            advice="Remove comments from the header.",
        )
    return None


def _newline_of(first: bytes) -> str:
    found = re.search(rb"\r\n|\n|\r", first)
    return {b"\r\n": "CRLF", b"\r": "CR"}.get(found[0] if found else b"\n", "LF")


class _Parsing:
    """A header half read."""

    def __init__(self, first: bytes, newline: str):
        self.first = first
        self.end = b"\r" if newline == "CR" else b"\n"
        self.offset = 0
        self.number = 0
        self.encoding: str | None = None
        self.elements: list[Element] = []

    def lines(self, complete: bool) -> Iterator[tuple[int, str]]:
        """(line number, words' text) of each whole line; `offset` is then the byte after it."""
        first = self.first[:HEADER_BYTES]
        while self.offset < len(first):
            cut = first.find(self.end, self.offset)
            if cut < 0 and not complete:
                return
            stop = len(first) if cut < 0 else cut
            text = first[self.offset : stop].decode("latin-1").strip()
            self.offset = min(stop + 1, len(first))
            self.number += 1
            yield self.number, text


def _take_line(state: _Parsing, number: int, text: str) -> bool:
    """Takes one line in; True at `end_header`."""
    words = text.split()
    keyword = words[0] if words else ""
    where = f"line {number}"
    if number == 1 or keyword in ("", "comment", "obj_info") or text.startswith(_NO_COMMENT):
        return False
    if keyword == "format":
        _take_format(state, words, where)
        return False
    if state.encoding is None and keyword in ("element", "property", "end_header"):
        raise _format_missing(where)
    if keyword == "element":
        state.elements.append(_element(words, number, where, state.elements))
    elif keyword == "property":
        _take_property(state, words, where)
    elif keyword == "end_header" and len(words) == 1:
        return True
    else:
        raise _line_error(text, where)
    return False


def _format_missing(where: str) -> FormatError:
    return PlyFormatMissing(
        "the header has no `format` line before its elements",
        where=where,
        advice="The second line must be `format ascii 1.0` or one of the binary formats.",
    )


def _line_error(text: str, where: str) -> FormatError:
    return PlyHeaderLine(
        f"{text[:60]!r} is not a line of a PLY header",
        where=where,
        advice="Each line is format, comment, obj_info, element, property or end_header.",
    )


def _take_format(state: _Parsing, words: list[str], where: str) -> None:
    if state.encoding is not None or state.elements or len(words) != 3:
        raise _line_error(" ".join(words), where)
    if words[1] not in _BYTE_ORDERS or words[2] != "1.0":
        raise PlyFormatUnsupported(
            f"the format {' '.join(words[1:])[:60]!r} does not exist",
            where=where,
            advice=f"It must be one of {', '.join(_BYTE_ORDERS)}, version 1.0.",
        )
    state.encoding = words[1]


def _element(words: list[str], number: int, where: str, before: list[Element]) -> Element:
    if len(words) != 3:
        raise _line_error(" ".join(words), where)
    name, count = words[1], words[2]
    if not re.fullmatch(r"[0-9]{1,18}", count) or int(count) > _LARGEST_COUNT:
        raise PlyElementCount(
            f"the count {count[:24]!r} of element {name[:24]!r} is not a whole number below 2³²",
            where=where,
            advice="Write the count as plain digits.",
        )
    if any(e.name == name for e in before):
        raise PlyElementDuplicate(
            f"element {name[:24]!r} is declared twice",
            where=where,
            advice="Declare each element once.",
        )
    return Element(name, int(count), number)


def _take_property(state: _Parsing, words: list[str], where: str) -> None:
    is_list = len(words) > 1 and words[1] == "list"
    if len(words) != (5 if is_list else 3) or not state.elements:
        raise _line_error(" ".join(words), where)
    kinds = [_kind(word, where) for word in words[1 + is_list : -1]]
    if is_list and kinds[0][0] == "f":
        raise PlyPropertyType(
            f"the length of list {words[-1][:24]!r} is declared as {words[2]}",
            where=where,
            advice="The length of a list is a whole number, usually uchar.",
        )
    length = kinds[0] if is_list else None
    state.elements[-1].properties.append(Property(words[-1], kinds[-1], length))


def _kind(word: str, where: str) -> str:
    if word not in _KINDS:
        raise PlyPropertyType(
            f"{word[:24]!r} is not a type of PLY",
            where=where,
            advice="Types are char, uchar, short, ushort, int, uint, float and double.",
        )
    return _KINDS[word]


def _check(header: PlyHeader, total_size: int | None, limits: Limits) -> None:
    """What the header alone can tell about the body."""
    vertex = header.vertex
    _check_coordinates(vertex)
    if vertex.count > limits.max_points:
        raise TooLarge(
            f"the header declares {vertex.count} points, more than {limits.max_points}",
            where=f"line {vertex.line}",
            advice="Thin the cloud, or reconstruct it in parts.",
        )
    if sum(e.count for e in header.elements if e is not vertex) > limits.max_rows:
        raise PlyTooManyRows(
            f"the header declares more than {limits.max_rows} faces and other rows",
            where="header",
            advice="Export the points without faces.",
        )
    if total_size is None:
        return
    least = sum(e.count * _least_bytes(e, header.order) for e in header.elements)
    # The last row of a text file may end without a newline.
    if least > total_size - header.body + (not header.order):
        raise PlyCountMismatch(
            f"the header declares at least {least} bytes of data, "
            f"the file has {total_size - header.body}",
            where=f"byte {total_size}",
            advice="The file is cut off, or the counts in its header are wrong.",
        )


def _least_bytes(element: Element, order: str) -> int:
    """Fewest bytes of one row: in text, a digit and a separator per value."""
    return element.least_row_bytes if order else 2 * len(element.properties)


def _check_coordinates(vertex: Element) -> None:
    names = [p.name for p in vertex.properties]
    roles = roles_of(names)
    missing = [axis for axis in COORDINATES if axis not in roles]
    lists = [a for a in COORDINATES if a in roles and vertex.properties[roles[a]].length]
    where = f"line {vertex.line}"
    if missing and "packed_position" in names:
        raise PlyVertexCoordinates(
            "the vertices are packed, as in compressed Gaussian splats",
            where=where,
            advice="Export the splats uncompressed, with x, y and z of each.",
        )
    if missing or lists:
        what = f"no {', '.join(missing)}" if missing else f"a list as {', '.join(lists)}"
        raise PlyVertexCoordinates(
            f"element {vertex.name[:24]!r} has {what}",
            where=where,
            advice="Each vertex needs scalar properties x, y and z.",
        )
    for axis in COORDINATES:
        if names.count(names[roles[axis]]) > 1:
            raise PlyPropertyDuplicate(
                f"{axis} is declared twice", where=where, advice="Declare each coordinate once."
            )
