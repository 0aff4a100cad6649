"""What a PLY header declares: elements and their properties."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from mpf_core.cloud.columns import COORDINATES, roles_of
from mpf_core.cloud.errors import PlyVertexMissing


@dataclass(frozen=True)
class Property:
    """One property: numpy's code of its `kind` ("f4") and, for a list, of its `length` ("u1")."""

    name: str
    kind: str
    length: str | None = None


@dataclass
class Element:
    """One element with its properties in the file's order."""

    name: str
    count: int
    line: int
    properties: list[Property] = field(default_factory=list)

    @property
    def has_lists(self) -> bool:
        """Whether the rows may differ in size."""
        return any(p.length is not None for p in self.properties)

    @property
    def least_row_bytes(self) -> int:
        """Bytes of a binary row whose lists are all empty."""
        return sum(np.dtype(p.length or p.kind).itemsize for p in self.properties)

    def row_type(self, order: str, lengths: tuple[int, ...] = ()) -> np.dtype[np.void]:
        """The packed binary row; `lengths` of its lists, in order.

        Fields are f0, f1, … and, for the length of a list, n0, n1, …: names may repeat in a file.
        """
        fields: list[tuple[str, str] | tuple[str, str, tuple[int]]] = []
        remaining = iter(lengths)
        for i, p in enumerate(self.properties):
            if p.length is None:
                fields.append((f"f{i}", order + p.kind))
            else:
                fields.append((f"n{i}", order + p.length))
                fields.append((f"f{i}", order + p.kind, (next(remaining),)))
        return np.dtype(fields)


@dataclass(frozen=True)
class PlyHeader:
    """A whole header.

    order: numpy's byte order of the body, or "" for text
    elements: in the file's order
    body: byte at which the body starts
    lines: number of header lines
    newline: "LF", "CRLF" or "CR"
    """

    encoding: str
    order: str
    elements: tuple[Element, ...]
    body: int
    lines: int
    newline: str

    @property
    def vertex(self) -> Element:
        """The element that holds the points."""
        named = [e for e in self.elements if e.name.lower() == "vertex"]
        if named:
            return named[0]
        # Some writers call it "point" or "vertices"; what has x, y and z is meant.
        for element in self.elements:
            if set(COORDINATES) <= roles_of([p.name for p in element.properties]).keys():
                return element
        raise PlyVertexMissing(
            "the header declares no element `vertex`",
            where="header",
            advice="Export the points as `element vertex` with properties x, y and z.",
        )
