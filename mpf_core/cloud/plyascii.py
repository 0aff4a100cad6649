"""The body of a text PLY file: one row per line, elements in the header's order."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np

from mpf_core.cloud.errors import (
    PlyCountMismatch,
    PlyListLength,
    PlyRowColumns,
    PlyRowNumber,
)
from mpf_core.cloud.plybinary import Targets
from mpf_core.cloud.plyschema import Element, PlyHeader
from mpf_core.cloud.textrows import RowStyle, is_number, line_blocks, mend, parse_lines

_STYLE = RowStyle(PlyRowColumns, PlyRowColumns, PlyRowNumber, comments=False)


@dataclass
class _Rows:
    """Lines that are not blank, with their numbers in the file."""

    lines: list[str]
    numbers: Sequence[int]

    def take(self, n: int) -> _Rows:
        """The first n rows, which are then gone from here."""
        taken = _Rows(self.lines[:n], self.numbers[:n])
        self.lines, self.numbers = self.lines[n:], self.numbers[n:]
        return taken


def read_ascii(stream: BinaryIO, header: PlyHeader, targets: Targets, max_line_bytes: int) -> int:
    """Fills the targets; returns the number of rows after the last element."""
    left_over = 0
    last = header.lines
    # Elements without properties have no rows in the file.
    waiting = [(e, e.count) for e in header.elements if e.properties and e.count]
    for rows in _blocks(stream, header, max_line_bytes):
        last = rows.numbers[-1] if rows.lines else last
        while rows.lines and waiting:
            element, missing = waiting[0]
            taken = rows.take(missing)
            if element is header.vertex:
                _store(element, taken, element.count - missing, targets)
            missing -= len(taken.lines)
            waiting[0] = (element, missing)
            if not missing:
                waiting.pop(0)
        left_over += len(rows.lines)
    if waiting:
        element, missing = waiting[0]
        raise PlyCountMismatch(
            f"{missing} of {element.count} rows of element {element.name[:24]!r} are missing",
            where=f"after line {last}",
            advice="The file is cut off, or the counts in its header are wrong.",
        )
    return left_over


def _blocks(stream: BinaryIO, header: PlyHeader, max_line_bytes: int) -> Iterator[_Rows]:
    for block in line_blocks(stream, header.body, header.lines + 1, _STYLE, max_line_bytes):
        if not block.text or block.text.isspace():
            continue
        lines = block.text.split("\n")
        full = [i for i, line in enumerate(lines) if line and not line.isspace()]
        if len(full) == len(lines):
            yield _Rows(lines, range(block.line, block.line + len(lines)))
        else:
            yield _Rows([lines[i] for i in full], [block.line + i for i in full])


def _store(element: Element, rows: _Rows, first: int, targets: Targets) -> None:
    part = slice(first, first + len(rows.lines))
    if element.has_lists:
        for place, line, number in zip(
            range(part.start, part.stop), rows.lines, rows.numbers, strict=True
        ):
            values = _scalars(element, line, number)
            for index, target in targets.items():
                target[place] = values[index]
        return
    table = parse_lines(rows.lines, rows.numbers, len(element.properties), _STYLE)
    for index, target in targets.items():
        target[part] = table[:, index]


def _scalars(element: Element, line: str, number: int) -> dict[int, float]:
    """Property index → value, for the scalar properties of a row that also holds lists."""
    fields = mend(line).split()
    values: dict[int, float] = {}
    at = 0
    for index, p in enumerate(element.properties):
        if at >= len(fields):
            raise _columns_error(number, len(fields))
        if p.length is not None:
            if not (fields[at].isascii() and fields[at].isdigit() and len(fields[at]) < 10):
                raise PlyListLength(
                    f"{fields[at][:24]!r} is not the length of a list",
                    where=f"line {number}",
                    advice="The row does not hold what the header declares.",
                )
            at += int(fields[at])
        elif not is_number(fields[at], _STYLE):
            raise PlyRowNumber(
                f"{fields[at][:24]!r} in line {number} is not a number",
                where=f"line {number}, column {at + 1}",
                advice="Mend the value or remove the row.",
            )
        else:
            values[index] = float(np.float64(fields[at]))
        at += 1
    if at != len(fields):
        raise _columns_error(number, len(fields))
    return values


def _columns_error(number: int, found: int) -> PlyRowColumns:
    return PlyRowColumns(
        f"line {number} has {found} values, which is not what the header declares",
        where=f"line {number}",
        advice="Check whether the row is cut off or joined with another.",
    )
