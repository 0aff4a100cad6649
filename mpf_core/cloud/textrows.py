"""Rows of numbers in text, parsed at the speed of numpy's C reader, block by block.

A block goes to the C reader as it is, without its comments. Where that fails it goes there in
parts, the spellings of odd printf's mended; only a part that fails too is looked at line by line,
to name the line that is wrong.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from mpf_core.errors import FormatError

BLOCK_BYTES = 1024 * 1024
COMMENT_MARKS = ("#", "//", "%", "!")

_PART_LINES = 4096
# Possessive (++): a run of comments is one match, and nothing in it is tried twice.
_COMMENT_LINES = re.compile(
    rf"^(?:[^\S\n]*+(?:{'|'.join(map(re.escape, COMMENT_MARKS))})[^\n]*+\n?)++", re.MULTILINE
)
_ODD_NUMBER = re.compile(r"[+-]?(?:1\.#(?:qnan|snan|ind|inf)\d*|nan\([^)\s]*\))", re.IGNORECASE)
_FORTRAN_EXPONENT = re.compile(r"(?<=[\d.])[dD](?=[+-]?\d)")


@dataclass(frozen=True)
class RowStyle:
    """How a row is written, and which errors say that it is not.

    delimiter: "," or ";" or a tab; None for any run of blanks
    decimal_comma: 1,5 means 1.5
    comments: lines may be comments
    """

    too_long: type[FormatError]
    bad_columns: type[FormatError]
    bad_number: type[FormatError]
    delimiter: str | None = None
    decimal_comma: bool = False
    comments: bool = True

    def split(self, line: str) -> list[str]:
        """The fields of one line."""
        if self.delimiter is None:
            return line.split()
        fields = [field.strip() for field in line.split(self.delimiter)]
        if len(fields) > 1 and not fields[-1]:
            fields.pop()  # a delimiter at the end of the row closes it
        return fields


@dataclass
class Block:
    """Whole lines of the file.

    text: without carriage returns; ends before a newline
    line: number of its first line
    """

    text: str
    line: int


def line_blocks(
    stream: BinaryIO, offset: int, line: int, style: RowStyle, max_line_bytes: int
) -> Iterator[Block]:
    """The file's lines from byte `offset`, which starts line `line`, in blocks of about 1 MiB."""
    stream.seek(offset)
    rest = b""
    while True:
        piece = stream.read(BLOCK_BYTES)
        data = rest + piece
        if not piece:
            break
        # A carriage return at the very end may be half of a CRLF: it waits for the next piece.
        cut = max(data.rfind(b"\n"), data.rfind(b"\r", 0, len(data) - 1)) + 1
        if len(data) - cut > max_line_bytes:
            where_line = line + _newlines(data[:cut])
            raise style.too_long(
                f"line {where_line} is longer than {max_line_bytes} bytes",
                where=f"line {where_line}",
                advice="Write one point per line.",
            )
        if cut:
            block = Block(_text(data[:cut])[:-1], line)
            yield block
            line += block.text.count("\n") + 1
        rest = data[cut:]
    if rest:
        yield Block(_text(rest).removesuffix("\n"), line)


def _text(data: bytes) -> str:
    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    return data.decode("latin-1")  # every byte is a character: what is no number fails as one


def _newlines(data: bytes) -> int:
    return _text(data).count("\n")


def parse_block(block: Block, columns: int, style: RowStyle) -> NDArray[np.float64]:
    """The rows of a block, (m, columns); blank and comment lines are passed over."""
    if not block.text or block.text.isspace():
        return np.empty((0, columns))
    text = _mended_cheaply(block.text, style)
    if not text or text.isspace():
        return np.empty((0, columns))
    table = _parse(text.split("\n"), style)
    if table is not None and table.shape[1] == columns:
        return table
    lines = block.text.split("\n")
    return _parse_in_parts(lines, range(block.line, block.line + len(lines)), columns, style)


def parse_lines(
    lines: list[str], numbers: Sequence[int], columns: int, style: RowStyle
) -> NDArray[np.float64]:
    """The same for lines that are already cut: one row (columns,) for each of them."""
    table = _parse(lines, style)
    if table is not None and table.shape == (len(lines), columns):
        return table
    return _parse_in_parts(lines, numbers, columns, style)


def _mended_cheaply(text: str, style: RowStyle) -> str:
    """What can be mended in the whole block at once."""
    if '"' in text:
        text = text.replace('"', "")
    if style.delimiter is not None:
        text = text.replace(style.delimiter + "\n", "\n").removesuffix(style.delimiter)
    if style.comments and any(mark in text for mark in COMMENT_MARKS):
        text = _COMMENT_LINES.sub("", text)
    return text


def _parse(lines: list[str], style: RowStyle) -> NDArray[np.float64] | None:
    if style.decimal_comma:
        lines = [line.replace(",", ".") for line in lines]
    if not any(lines):
        return None  # the C reader warns on no data at all
    try:
        return np.loadtxt(
            lines, dtype=np.float64, comments=None, delimiter=style.delimiter, ndmin=2
        )
    except ValueError:
        return None


def _parse_in_parts(
    lines: list[str], numbers: Sequence[int], columns: int, style: RowStyle
) -> NDArray[np.float64]:
    tables = [np.empty((0, columns))]
    for start in range(0, len(lines), _PART_LINES):
        part = slice(start, start + _PART_LINES)
        kept = [line for line in lines[part] if not is_passed_over(line, style)]
        if not kept:
            continue
        table = _parse(mend("\n".join(kept)).split("\n"), style)
        if table is None or table.shape != (len(kept), columns):
            table = _parse_slowly(lines[part], numbers[part], columns, style)
        tables.append(table)
    return np.concatenate(tables)


def _parse_slowly(
    lines: list[str], numbers: Sequence[int], columns: int, style: RowStyle
) -> NDArray[np.float64]:
    kept: list[str] = []
    separator = style.delimiter or " "
    for number, line in zip(numbers, lines, strict=True):
        if is_passed_over(line, style):
            continue
        fields = style.split(mend(line))
        if len(fields) != columns:
            raise style.bad_columns(
                f"line {number} has {len(fields)} columns where {columns} are expected",
                where=f"line {number}",
                advice="Check whether the row is cut off or joined with another.",
            )
        _check_numbers(fields, number, style)
        kept.append(separator.join(fields))
    if not kept:
        return np.empty((0, columns))
    table = _parse(kept, style)
    if table is None or table.shape != (len(kept), columns):
        raise style.bad_number(
            "a value is not a number",
            where=f"lines {numbers[0]} to {numbers[-1]}",
            advice="Export the file again as plain numbers.",
        )
    return table


def is_passed_over(line: str, style: RowStyle) -> bool:
    """Blank, or a comment where comments are allowed."""
    bare = line.strip()
    return not bare or (style.comments and bare.startswith(COMMENT_MARKS))


def mend(text: str) -> str:
    """Text, of one line or many, with quotes gone and odd spellings of numbers as C reads them."""
    if '"' in text or "'" in text:
        text = text.replace('"', "").replace("'", "")
    if "#" in text or "(" in text:
        text = _ODD_NUMBER.sub(lambda m: "inf" if "inf" in m[0].lower() else "nan", text)
    return _FORTRAN_EXPONENT.sub("e", text) if "d" in text or "D" in text else text


def is_number(field: str, style: RowStyle) -> bool:
    """Whether the C reader takes the field for a number."""
    field = field.replace(",", ".") if style.decimal_comma else field
    try:
        float(field)
    except ValueError:
        return False
    return "_" not in field and field.isascii()  # Python's float takes more than a file may say


def _check_numbers(fields: list[str], number: int, style: RowStyle) -> None:
    for column, field in enumerate(fields, start=1):
        if not is_number(field, style):
            shown = field if len(field) <= 24 else field[:24] + "…"
            raise style.bad_number(
                f"{shown!r} in line {number} is not a number",
                where=f"line {number}, column {column}",
                advice="Mend the value or remove the row."
                if field
                else "Fill the empty field or remove the row.",
            )
