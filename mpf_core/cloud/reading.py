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
