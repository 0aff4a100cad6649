"""Meshes as files: GLB for viewers, binary PLY for tools that measure.

Coordinates are written as they are. glTF calls +y up; what is up in a cloud is not known, so
nothing is turned.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpf_core.cloud.pointcloud import PointCloud
from mpf_core.errors import NoSurface, SurfaceError
from mpf_core.files import write_atomically
from mpf_core.surface.mesh import Mesh
from mpf_core.surface.normals import unit_normals, vertex_normals

_FLOAT, _UNSIGNED_SHORT, _UNSIGNED_INT = 5126, 5123, 5125
_VERTEX_DATA, _INDEX_DATA = 34962, 34963
_BARE_GREY = [0.6, 0.6, 0.6, 1.0]


def write_glb(mesh: Mesh, path: str | Path, *, name: str = "surface") -> None:
    """Write `mesh` as binary glTF 2.0, atomically; see `glb_bytes`."""
    write_atomically(path, glb_bytes(mesh, name=name))


def write_ply(mesh: Mesh, path: str | Path) -> None:
    """Write `mesh` as binary little-endian PLY, atomically; see `ply_bytes`."""
    write_atomically(path, ply_bytes(mesh))


def write_mesh(mesh: Mesh, path: Path) -> None:
    """Write `mesh` as what the path's ending says: .ply, or .glb for everything else."""
    (write_ply if path.suffix.lower() == ".ply" else write_glb)(mesh, path)


def glb_bytes(mesh: Mesh, *, name: str = "surface") -> bytes:
    """`mesh` as a GLB with vertex normals, colours if it has any, and a matt two-sided material.

    Vertices are float32 about the middle of the box, and the node's translation, in double, puts
    them back: UTM coordinates keep their millimetres. Colours are linear there, as glTF wants.
    """
    _check(mesh)
    middle = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
    local = (mesh.vertices - middle).astype("<f4")
    normals = vertex_normals(mesh) if mesh.normals is None else unit_normals(mesh.normals)
    content = _Glb(name)
    position = content.add(local, _FLOAT, "VEC3", _VERTEX_DATA)
    content.accessors[position] |= {
        "min": local.min(axis=0).tolist(),
        "max": local.max(axis=0).tolist(),
    }
    attributes = {
        "POSITION": position,
        "NORMAL": content.add(normals.astype("<f4"), _FLOAT, "VEC3", _VERTEX_DATA),
    }
    if mesh.colors is not None:
        colors = _linear_rgba(mesh.colors)
        attributes["COLOR_0"] = content.add(colors, _UNSIGNED_SHORT, "VEC4", _VERTEX_DATA)
        content.accessors[-1]["normalized"] = True
    indices = mesh.faces.astype("<u4").reshape(-1)
    faces = content.add(indices, _UNSIGNED_INT, "SCALAR", _INDEX_DATA)
    base_color = [1.0] * 4 if mesh.colors is not None else _BARE_GREY
    return content.assemble(attributes, faces, middle, base_color)


def ply_bytes(mesh: Mesh) -> bytes:
    """`mesh` as PLY: double coordinates, float normals and uchar colours when it has them."""
    _check(mesh)
    header, vertices = _ply_vertices(mesh.vertices, mesh.normals, mesh.colors)
    faces = np.empty(len(mesh.faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, mesh.faces
    header += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    return _ply(header, vertices, faces)


def cloud_ply_bytes(cloud: PointCloud, comments: Sequence[str] = ()) -> bytes:
    """A cloud as PLY, as `ply_bytes` writes vertices; `comments` are lines of ASCII."""
    header, vertices = _ply_vertices(cloud.points, cloud.normals, cloud.colors)
    return _ply([*(f"comment {line}" for line in comments), *header], vertices)


def _ply_vertices(
    points: NDArray[np.float64],
    normals: NDArray[np.float64] | None,
    colors: NDArray[np.uint8] | None,
) -> tuple[list[str], NDArray[Any]]:
    """The lines of the header that declare the vertices, and their rows."""
    columns: list[tuple[str, str, str, NDArray[Any]]] = [
        (axis, "double", "<f8", points[:, k]) for k, axis in enumerate("xyz")
    ]
    if normals is not None:
        columns += [(f"n{a}", "float", "<f4", normals[:, k]) for k, a in enumerate("xyz")]
    if colors is not None:
        names = ("red", "green", "blue")
        columns += [(c, "uchar", "u1", colors[:, k]) for k, c in enumerate(names)]
    rows = np.empty(len(points), dtype=[(c[0], c[2]) for c in columns])
    for column, _, _, values in columns:
        rows[column] = values
    properties = [f"property {kind} {column}" for column, kind, _, _ in columns]
    return [f"element vertex {len(rows)}", *properties], rows


def _ply(header: list[str], *tables: NDArray[Any]) -> bytes:
    lines = ["ply", "format binary_little_endian 1.0", *header, "end_header\n"]
    return "\n".join(lines).encode("ascii") + b"".join(table.tobytes() for table in tables)


class _Glb:
    """The JSON and binary chunks of a GLB of one mesh, as they grow."""

    def __init__(self, name: str):
        self.name = name
        self.binary = bytearray()
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    def add(self, values: NDArray[Any], component: int, kind: str, target: int) -> int:
        """Append an array (a multiple of four bytes long) and return its accessor's index."""
        content = np.ascontiguousarray(values).tobytes()
        view = {"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(content)}
        self.binary += content
        self.views.append(view | {"target": target})
        self.accessors.append(
            {
                "bufferView": len(self.views) - 1,
                "componentType": component,
                "count": len(values),
                "type": kind,
            }
        )
        return len(self.accessors) - 1

    def assemble(
        self,
        attributes: dict[str, int],
        faces: int,
        middle: NDArray[np.float64],
        base_color: list[float],
    ) -> bytes:
        document = {
            "asset": {"version": "2.0", "generator": "metric-phase-fields"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"name": self.name, "mesh": 0, "translation": middle.tolist()}],
            "meshes": [
                {
                    "name": self.name,
                    "primitives": [{"attributes": attributes, "indices": faces, "material": 0}],
                }
            ],
            "materials": [
                {
                    "name": "matt",
                    "pbrMetallicRoughness": {
                        "baseColorFactor": base_color,
                        "metallicFactor": 0.0,
                        "roughnessFactor": 0.8,
                    },
                    "doubleSided": True,
                }
            ],
            "accessors": self.accessors,
            "bufferViews": self.views,
            "buffers": [{"byteLength": len(self.binary)}],
        }
        text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode("utf-8")
        chunks = _chunk(text, b"JSON", b" ") + _chunk(bytes(self.binary), b"BIN\0", b"\0")
        length = 12 + len(chunks)
        if length >= 2**32:
            raise SurfaceError("the mesh is too large for a GLB", advice="Write a PLY instead.")
        return struct.pack("<4sII", b"glTF", 2, length) + chunks


def _chunk(content: bytes, kind: bytes, padding: bytes) -> bytes:
    content += padding * (-len(content) % 4)
    return struct.pack("<I4s", len(content), kind) + content


def _linear_rgba(colors: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """(v, 4) linear light in 16 bits of (v, 3) sRGB in 8; fine enough to tell all 256 apart."""
    level = np.arange(256) / 255
    linear = np.where(level <= 0.04045, level / 12.92, ((level + 0.055) / 1.055) ** 2.4)
    table = np.round(linear * 65535).astype("<u2")
    opaque = np.full((len(colors), 1), 65535, dtype="<u2")
    return np.concatenate([table[colors], opaque], axis=1)


def _check(mesh: Mesh) -> None:
    if len(mesh.faces) == 0 or len(mesh.vertices) == 0:
        raise NoSurface("there are no triangles to write")
    if not np.isfinite(mesh.vertices).all():
        raise SurfaceError("the mesh has vertices that are not finite numbers")
