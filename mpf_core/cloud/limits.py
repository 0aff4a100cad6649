"""What a reader may cost."""

from __future__ import annotations

from dataclasses import dataclass

MINIMUM_POINTS = 51
"""Distinct points that the neighbourhoods need: fifty neighbours and the point itself."""

HEADER_BYTES = 64 * 1024
"""First bytes of a file that suffice for `peek_header`; a longer PLY header is refused."""


@dataclass(frozen=True)
class Limits:
    """Caps that hold before anything is allocated.

    max_bytes: size of the file, bytes
    max_points: points in the file
    max_rows: rows of all other PLY elements together (faces, edges)
    max_columns: columns of a text row
    max_line_bytes: length of one text line, bytes
    """

    max_bytes: int = 4 * 1024**3
    max_points: int = 10_000_000
    max_rows: int = 50_000_000
    max_columns: int = 128
    max_line_bytes: int = 1024 * 1024


DEFAULT_LIMITS = Limits()
