"""What a reader found: the cloud and how it came to it."""

from __future__ import annotations

from dataclasses import dataclass

from mpf_core.cloud.pointcloud import PointCloud


@dataclass(frozen=True)
class Column:
    """One column or property of the file.

    name: as the file calls it, or "column 4" where it has no name
    meaning: what it was taken for: "x", "normal x", "red", "intensity", "left out", …
    """

    name: str
    meaning: str


@dataclass(frozen=True)
class Reading:
    """A cloud with the reader's account of it.

    format: "ply" or "xyz"
    dialect: the variant in words, e.g. "binary little endian, CRLF header"
    columns: of the points, in the file's order
    warnings: what a user should look at: ambiguity, damage that was tolerated
    """

    cloud: PointCloud
    format: str
    dialect: str
    columns: tuple[Column, ...]
    warnings: tuple[str, ...] = ()


_LEFT_OUT = "left out"
_SHOWN = 6  # names of columns left out, before "and n more"


def describe_columns(columns: tuple[Column, ...]) -> str:
    """The columns in one sentence; a splat has sixty, of which few are read."""
    said = [f"{c.name} → {c.meaning}" for c in columns if c.meaning != _LEFT_OUT]
    others = [c.name for c in columns if c.meaning == _LEFT_OUT]
    if others:
        more = f" and {len(others) - _SHOWN} more" if len(others) > _SHOWN else ""
        said.append(f"left out: {', '.join(others[:_SHOWN])}{more}")
    return ", ".join(said)
