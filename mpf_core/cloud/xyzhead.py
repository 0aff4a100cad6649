"""The first lines of a text cloud: count, header, delimiter, number of columns."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace

from mpf_core.cloud.columns import COORDINATES, roles_of
from mpf_core.cloud.errors import (
    FormatUnknown,
    XyzColumnsTooFew,
    XyzColumnsTooMany,
    XyzCountMismatch,
    XyzEncoding,
    XyzHeaderColumns,
    XyzLineTooLong,
    XyzNoPoints,
    XyzRowColumns,
    XyzRowNumber,
)
from mpf_core.cloud.limits import Limits
from mpf_core.cloud.textrows import COMMENT_MARKS, RowStyle, is_number, is_passed_over, mend
from mpf_core.errors import TooLarge

SAMPLE_ROWS = 50
UTF8_MARK = b"\xef\xbb\xbf"
_WIDE_MARKS = (b"\xff\xfe", b"\xfe\xff")

_BLANKS = RowStyle(XyzLineTooLong, XyzRowColumns, XyzRowNumber)
STYLES = (
    _BLANKS,
    replace(_BLANKS, delimiter=","),
    replace(_BLANKS, delimiter=";"),
    replace(_BLANKS, decimal_comma=True),
    replace(_BLANKS, delimiter=";", decimal_comma=True),
)


@dataclass(frozen=True)
class TextHead:
    """What the lines before the first row say, and what that row looks like.

    style: delimiter and decimal mark
    columns: fields of the first row
    names: one per column where a header names them, else None
    declared: the leading count, or None
    offset, line: of the first row; bytes and line number
    dialect: the variant in words
    warnings: what the header left unclear
    """

    style: RowStyle
    columns: int
    names: tuple[str, ...] | None
    declared: int | None
    offset: int
    line: int
    dialect: str
    warnings: tuple[str, ...]


@dataclass
class _Prologue:
    """Lines before the first row."""

    declared: int | None = None
    header: str | None = None
    header_line: int = 0
    comment_header: str | None = None
    comments: int = 0


def read_head(first: bytes, total_size: int | None, limits: Limits) -> TextHead:
    """The head of a text cloud from its first bytes (the whole file, or at least 64 KiB).

    total_size: bytes of the whole file, or None if not yet known.
    """
    _refuse_other_encodings(first)
    prologue = _Prologue()
    sample: list[str] = []
    offset = line = 0
    for number, start, text in _lines(first):
        if not sample:
            if is_passed_over(text, _BLANKS):
                _note_comment(prologue, text)
                continue
            if _belongs_to_prologue(prologue, text, number):
                continue
            offset, line = start, number
        if not is_passed_over(text, _BLANKS):
            sample.append(text)
        if len(sample) == SAMPLE_ROWS:
            break
    if not sample:
        raise _no_rows(prologue, complete=total_size is None or total_size <= len(first))
    if total_size is None or total_size > len(first):
        sample = sample[:-1] or sample  # the last line may be cut off
    style, columns = _style_of(sample, line, limits)
    names, warnings = _names(prologue, style, columns)
    head = TextHead(
        style, columns, names, prologue.declared, offset, line,
        _dialect(first, prologue, style, names), tuple(warnings),
    )  # fmt: skip
    _check_count(head, total_size, limits)
    return head


def _refuse_other_encodings(first: bytes) -> None:
    if first.startswith(_WIDE_MARKS):
        raise XyzEncoding(
            "the text is in UTF-16 or UTF-32",
            where="byte 0",
            advice="Save it as UTF-8 or plain ASCII.",
        )
    zero = first.find(b"\0")
    if zero >= 0:
        raise FormatUnknown(
            "the file holds binary data but is not PLY",
            where=f"byte {zero}",
            advice="Export the cloud as PLY or as text rows x y z.",
        )


def _lines(first: bytes) -> Iterator[tuple[int, int, str]]:
    """(line number, byte offset, text) of each line; \\n, \\r\\n and \\r all end one."""
    start = len(UTF8_MARK) if first.startswith(UTF8_MARK) else 0
    for number, found in enumerate(re.finditer(rb"[^\r\n]*(?:\r\n|\n|\r|$)", first[start:]), 1):
        if found.end() > found.start():
            yield number, start + found.start(), found[0].rstrip(b"\r\n").decode("latin-1")


def _note_comment(prologue: _Prologue, text: str) -> None:
    if not text.strip():
        return
    prologue.comments += 1
    bare = text.strip().lstrip("".join(COMMENT_MARKS) + " ")
    if set(COORDINATES) <= roles_of(re.split(r"[\s,;]+", bare)).keys():
        prologue.comment_header = bare


def _belongs_to_prologue(prologue: _Prologue, text: str, number: int) -> bool:
    fields = [field for field in re.split(r"[\s,;]+", mend(text).strip()) if field]
    if not fields:
        return False
    if prologue.declared is None and len(fields) == 1 and re.fullmatch(r"\d{1,18}", fields[0]):
        prologue.declared = int(fields[0])
        return True
    if re.match(r"[+-]?\.?\d", fields[0]) or is_number(fields[0], _BLANKS):
        return False
    if prologue.header is None:
        prologue.header, prologue.header_line = text, number
        return True
    raise FormatUnknown(
        f"line {number} is not a row of numbers",
        where=f"line {number}",
        advice="Give rows x y z, with at most one header line of names above them.",
    )


def _no_rows(prologue: _Prologue, *, complete: bool) -> Exception:
    named = (
        prologue.header is not None
        and set(COORDINATES) <= roles_of(re.split(r"[\s,;]+", prologue.header)).keys()
    )
    if named or prologue.header is None:
        missing = "there are no rows of numbers" if complete else "no row of numbers comes first"
        return XyzNoPoints(missing, advice="Give one point per line: x y z.")
    return FormatUnknown(
        "the file is neither PLY nor rows of numbers",
        where=f"line {prologue.header_line}",
        advice="Give a PLY file, or text with one point per line: x y z.",
    )


def _style_of(sample: list[str], line: int, limits: Limits) -> tuple[RowStyle, int]:
    """The first style in which the sample (or else its first row) reads as numbers."""
    for rows in (sample, sample[:1]):
        for style in STYLES:
            widths = {_width(row, style) for row in rows}
            if len(widths) == 1 and widths.pop() >= len(COORDINATES):
                width = _common_width(sample, style)
                if width > limits.max_columns:
                    raise XyzColumnsTooMany(
                        f"line {line} has {width} columns, more than {limits.max_columns}",
                        where=f"line {line}",
                        advice="Keep the coordinates, normals and colours only.",
                    )
                return style, width
    return _fallback(sample[0], line)


def _common_width(sample: list[str], style: RowStyle) -> int:
    """The first row's, unless it stands alone among others: then it is the odd one."""
    counts = Counter(_width(row, style) for row in sample)
    first = _width(sample[0], style)
    common, times = counts.most_common(1)[0]
    return common if counts[first] == 1 < times and common >= len(COORDINATES) else first


def _width(row: str, style: RowStyle) -> int:
    """Number of fields, or 0 if one of them is not a number."""
    fields = style.split(mend(row))
    return len(fields) if all(is_number(field, style) for field in fields) else 0


def _fallback(row: str, line: int) -> tuple[RowStyle, int]:
    """Raises the error that says why the first row is none."""
    style = STYLES[2] if ";" in row else STYLES[1] if "," in row else _BLANKS
    fields = style.split(mend(row))
    bad = next((field for field in fields if not is_number(field, style)), None)
    if bad is not None:
        raise XyzRowNumber(
            f"{bad[:24]!r} in line {line} is not a number",
            where=f"line {line}, column {fields.index(bad) + 1}",
            advice="Give numbers separated by spaces, tabs, commas or semicolons.",
        )
    raise XyzColumnsTooFew(
        f"line {line} has {len(fields)} columns",
        where=f"line {line}",
        advice="Give at least x, y and z in each row.",
    )


def _names(
    prologue: _Prologue, style: RowStyle, columns: int
) -> tuple[tuple[str, ...] | None, list[str]]:
    header = prologue.header or prologue.comment_header
    if header is None:
        return None, []
    for pattern in (re.escape(style.delimiter or "\t"), r"\t", ",", ";", r"\s+", r"[\s,;]+"):
        names = [name.strip().strip("\"'") for name in re.split(pattern, header.strip())]
        while len(names) > columns and not names[-1]:
            names.pop()
        roles = roles_of(names)
        if len(names) == columns and set(COORDINATES) <= roles.keys():
            return tuple(names), []
    return None, [_unclear_header(prologue, header, columns)]


def _unclear_header(prologue: _Prologue, header: str, columns: int) -> str:
    """Says how a header was set aside, or raises if going on would be a guess."""
    names = [name for name in re.split(r"[\s,;]+", header.strip()) if name]
    roles = roles_of(names)
    leading = [roles.get(axis) for axis in COORDINATES] == [0, 1, 2]
    known = [axis for axis in COORDINATES if axis in roles]
    if prologue.header is not None and known and not leading:
        missing = [axis for axis in COORDINATES if axis not in roles]
        fault = f"and no {', '.join(missing)}" if missing else f"and the rows have {columns}"
        raise XyzHeaderColumns(
            f"the header names {len(names)} columns ({', '.join(names)[:60]}) {fault}",
            where=f"line {prologue.header_line}",
            advice="Name each column once, x, y and z among them.",
        )
    why = f"names {len(names)} columns of {columns}" if known else "has no names that are known"
    return f"the header {why}; the columns are told apart by their place and values"


def _dialect(
    first: bytes, prologue: _Prologue, style: RowStyle, names: tuple[str, ...] | None
) -> str:
    delimiters = {",": "commas", ";": "semicolons"}
    sample = first[:4096]
    tabs = b"\t" in sample and b" " not in sample.strip()
    words = [delimiters.get(style.delimiter or "", "tabs" if tabs else "blanks")]
    if style.decimal_comma:
        words.append("decimal commas")
    if b"\r\n" in sample:
        words.append("CRLF")
    elif b"\r" in sample:
        words.append("CR")
    if first.startswith(UTF8_MARK):
        words.append("UTF-8 mark")
    if prologue.declared is not None:
        words.append("leading count")
    if prologue.header is not None or names is not None:
        words.append("header line")
    if prologue.comments:
        words.append("comments")
    return ", ".join(words)


def _check_count(head: TextHead, total_size: int | None, limits: Limits) -> None:
    if head.declared is None:
        return
    if head.declared > limits.max_points:
        raise TooLarge(
            f"the file declares {head.declared} points, more than {limits.max_points}",
            where="the leading count",
            advice="Thin the cloud, or reconstruct it in parts.",
        )
    shortest = 2 * head.columns  # one digit and one separator per value
    if total_size is not None and head.declared * shortest > total_size - head.offset + 1:
        raise count_mismatch(head.declared, "fewer fit into the file")


def count_mismatch(declared: int, found: str) -> XyzCountMismatch:
    """The error for a leading count that is more than the number of rows."""
    return XyzCountMismatch(
        f"the first line declares {declared} points and {found}",
        where="the leading count",
        advice="Correct the count or remove it, and check whether the file is cut off.",
    )
