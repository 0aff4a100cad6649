"""PLY point clouds, and meshes read as clouds: text and both binary byte orders."""

from __future__ import annotations

from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from mpf_core.cloud.attributes import colors_to_uint8, splat_colors, unit_normals
from mpf_core.cloud.columns import COLORS, COORDINATES, NORMALS, SPLAT_COLORS, meaning_of, roles_of
from mpf_core.cloud.limits import DEFAULT_LIMITS, HEADER_BYTES, Limits
from mpf_core.cloud.plyascii import read_ascii
from mpf_core.cloud.plybinary import read_binary
from mpf_core.cloud.plyheader import parse_header
from mpf_core.cloud.plyschema import Element, PlyHeader
from mpf_core.cloud.pointcloud import PointCloud
from mpf_core.cloud.reading import Column, Reading, describe_columns

_TRANSPARENT = -2.197224577336219  # logit of opacity 0.1


def read_ply(stream: BinaryIO, size: int, limits: Limits = DEFAULT_LIMITS) -> Reading:
    """The vertices of the PLY file in `stream`, which is `size` bytes long."""
    stream.seek(0)
    first = stream.read(HEADER_BYTES)
    header = parse_header(first, size, limits)
    assert header is not None
    vertices = _Vertices(header)
    if header.order:
        trailing, unit = read_binary(stream, size, header, vertices.targets), "bytes"
    else:
        rows = read_ascii(stream, header, vertices.targets, limits.max_line_bytes)
        trailing, unit = rows, "lines"
    warnings = [f"{trailing} {unit} after the last element are left out"] if trailing else []
    return vertices.reading(warnings)


class _Vertices:
    """Arrays for the properties that are read, and what they become."""

    def __init__(self, header: PlyHeader):
        self.header = header
        self.element = header.vertex
        self.notes: list[str] = []
        self.warnings: list[str] = []
        self.roles = _scalar_roles(self.element)
        self.points = np.empty((self.element.count, 3))
        self.targets: dict[int, NDArray[Any]] = {}
        self._aim(COORDINATES, self.points)
        self.normals = self._triple(NORMALS, "normals")
        self.colors = self._triple(COLORS, "colours")
        self.splats = None if self.colors is not None else self._triple(SPLAT_COLORS, "colours")
        self.opacity: NDArray[Any] | None = None
        if self.splats is not None and "opacity" in self.roles:
            self.opacity = np.empty(self.element.count, dtype=np.float32)
            self.targets[self.roles["opacity"]] = self.opacity

    def _aim(self, triple: tuple[str, ...], array: NDArray[Any]) -> None:
        for i, role in enumerate(triple):
            self.targets[self.roles[role]] = array[:, i]

    def _triple(self, triple: tuple[str, ...], what: str) -> NDArray[Any] | None:
        """An array (n, 3) that the three properties go to; None if they are not all there."""
        present = [role for role in triple if role in self.roles]
        if present and len(present) < len(triple):
            self.warnings.append(f"there is only {', '.join(present)}: no {what} are read")
        kinds = [self.element.properties[self.roles[role]].kind for role in present]
        if len(present) == 3 and triple == NORMALS and any(kind[0] == "u" for kind in kinds):
            self.warnings.append("normals of unsigned type have no sign and are left out")
            present = []
        if len(present) < len(triple):
            for role in triple:
                self.roles.pop(role, None)
            return None
        kind: Any = np.result_type(*kinds) if self.header.order else np.float64
        array = np.empty((self.element.count, 3), dtype=np.float64 if triple == NORMALS else kind)
        self._aim(triple, array)
        return array

    def reading(self, warnings: list[str]) -> Reading:
        """The cloud with its account."""
        normals = None
        if self.normals is not None:
            normals, said = unit_normals(self.normals)
            self.notes += said
        colors = self._uint8_colors()
        columns = self._columns()
        notes = [f"columns: {describe_columns(columns)}"]
        notes += self._other_elements()
        notes += self.notes
        self.warnings += warnings
        cloud = PointCloud(self.points, normals, colors, notes=(*notes, *self.warnings))
        return Reading(cloud, "ply", self._dialect(), columns, tuple(self.warnings))

    def _uint8_colors(self) -> NDArray[np.uint8] | None:
        if self.splats is not None:
            return self._splat_colors(self.splats)
        if self.colors is None:
            return None
        kinds = [self.element.properties[self.roles[role]].kind for role in COLORS]
        whole = all(kind[0] in "iu" for kind in kinds)
        colors, scale, guessed = colors_to_uint8(self.colors, whole=whole, sixteen="u2" in kinds)
        if colors is None:
            self.warnings.append(f"colours are {scale}: no known scale, left out")
        elif guessed:
            self.warnings.append(f"colours are taken to be on the scale {scale}")
        else:
            self.notes.append(f"colours read on the scale {scale}")
        return colors

    def _splat_colors(self, harmonics: NDArray[Any]) -> NDArray[np.uint8] | None:
        self.notes.append("Gaussian splats: their centres read as points, their base colours kept")
        if self.opacity is not None and (faint := int((self.opacity < _TRANSPARENT).sum())):
            self.warnings.append(
                f"{faint} of {len(self.points)} splats are nearly transparent (opacity below 0.1)"
            )
        colors = splat_colors(harmonics)
        if colors is None:
            self.warnings.append("colours are not finite and are left out")
        return colors

    def _columns(self) -> tuple[Column, ...]:
        meanings = {index: meaning_of(role) for role, index in self.roles.items()}
        for role in ("intensity", "alpha"):
            if role in self.roles:
                meanings[self.roles[role]] = f"{role} (left out)"
        if "opacity" in self.roles:
            used = "reported" if self.opacity is not None else "left out"
            meanings[self.roles["opacity"]] = f"opacity ({used})"
        return tuple(
            Column(p.name, "list, skipped" if p.length else meanings.get(i, "left out"))
            for i, p in enumerate(self.element.properties)
        )

    def _other_elements(self) -> list[str]:
        said = []
        for element in self.header.elements:
            if element is self.element or not element.count:
                continue
            if element.name in ("face", "tristrips"):
                said.append(
                    f"the file is a mesh: its vertices read as points, {element.count} rows of "
                    f"{element.name} skipped"
                )
            else:
                said.append(f"{element.count} rows of element {element.name[:24]} skipped")
        return said

    def _dialect(self) -> str:
        encoding = self.header.encoding.replace("_", " ")
        newline = "" if self.header.newline == "LF" else f", {self.header.newline} header"
        named = "" if self.element.name == "vertex" else f", points in {self.element.name[:24]}"
        return encoding + newline + named


def _scalar_roles(element: Element) -> dict[str, int]:
    names = ["" if p.length else p.name for p in element.properties]
    return roles_of(names)
