"""What the first bytes of an input tell, and what its content must be."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from mpf_core.cloud.limits import HEADER_BYTES, Limits
from mpf_core.cloud.reader import peek_header


@dataclass(frozen=True)
class Header:
    """format: "ply" or "xyz"; points: as declared, or None where the header has no count."""

    format: str
    points: int | None


def peek(head: bytes, limits: Limits, *, size: int | None) -> Header:
    """Judge the first bytes of an input; `size` is that of the whole file, once it is known.

    Raises InputError for what no later byte can mend.
    """
    facts = peek_header(head, size, limits=limits)
    return Header(facts.format, facts.declared_points)


def require_usable(path: Path, max_points: int) -> int:
    """Read the whole input and judge its points; how many there are. Raises InputError."""
    from mpf_core.cloud.prepare import PrepareOptions, prepare
    from mpf_core.cloud.reader import read_cloud

    cloud = read_cloud(path, limits=Limits(max_points=max_points))
    prepare(cloud, PrepareOptions(max_points=max_points))
    return len(cloud)


__all__ = ["HEADER_BYTES", "Header", "peek", "require_usable"]
