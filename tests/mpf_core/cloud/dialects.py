"""Writers of every dialect that the readers know, for tests: a cloud in, a file's bytes out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from mpf_core.cloud.pointcloud import PointCloud


@dataclass(frozen=True)
class PlyDialect:
    """One way to write PLY; kinds are numpy's codes."""

    encoding: str = "ascii"
    newline: str = "\n"
    coordinates: str = "f8"
    colors: str = "u1"
    new_names: bool = False
    color_names: tuple[str, str, str] = ("red", "green", "blue")
    colors_first: bool = False
    faces: str = "none"  # none, before, after
    mixed_faces: bool = False
    vertex_list: str = "none"  # none, first, last: a list property among the vertex's
    comments: bool = False
    trailing: bytes = b""


OLD = {
    "i1": "char", "u1": "uchar", "i2": "short", "u2": "ushort", "i4": "int", "u4": "uint",
    "f4": "float", "f8": "double",
}  # fmt: skip
NEW = {
    "i1": "int8", "u1": "uint8", "i2": "int16", "u2": "uint16", "i4": "int32", "u4": "uint32",
    "f4": "float32", "f8": "float64",
}  # fmt: skip

ply_dialects = st.builds(
    PlyDialect,
    encoding=st.sampled_from(["ascii", "binary_little_endian", "binary_big_endian"]),
    newline=st.sampled_from(["\n", "\r\n"]),
    coordinates=st.sampled_from(["f4", "f8"]),
    colors=st.sampled_from(["u1", "u2", "f4", "f8"]),
    new_names=st.booleans(),
    color_names=st.sampled_from(
        [
            ("red", "green", "blue"),
            ("r", "g", "b"),
            ("diffuse_red", "diffuse_green", "diffuse_blue"),
        ]
    ),
    colors_first=st.booleans(),
    faces=st.sampled_from(["none", "before", "after"]),
    mixed_faces=st.booleans(),
    vertex_list=st.sampled_from(["none", "first", "last"]),
    comments=st.booleans(),
    trailing=st.sampled_from([b"", b"\n", b"trailing words\n"]),
)


@st.composite
def clouds(draw: st.DrawFn, *, single: bool = False, least: int = 0) -> PointCloud:
    """Any small cloud; with `single`, of coordinates that single precision holds."""
    n = draw(st.integers(least, 12))
    width = 32 if single else 64
    number = st.floats(-1e6, 1e6, width=width, allow_subnormal=False)
    points = draw(arrays(f"f{width // 8}", (n, 3), elements=number)).astype(np.float64)
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    normals = colors = None
    if draw(st.booleans()):
        normals = rng.normal(size=(n, 3))
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        normals = normals.astype(np.float32).astype(np.float64) if single else normals
    if draw(st.booleans()):
        colors = rng.integers(0, 256, size=(n, 3), dtype=np.uint8)
        if n:
            colors[0] = (2, 255, 0)  # a cloud of black points only has no colours to find
    return PointCloud(points, normals, colors)


def ply_bytes(cloud: PointCloud, d: PlyDialect) -> bytes:
    """The cloud as a PLY file."""
    names = NEW if d.new_names else OLD
    columns = _ply_columns(cloud, d)
    properties = [f"property {names[kind]} {name}" for name, kind, _ in columns]
    row_lists = [list(range(i % 3)) for i in range(len(cloud))]
    listed = f"property list {names['u1']} {names['i4']} links"
    if d.vertex_list == "first":
        properties.insert(0, listed)
    elif d.vertex_list == "last":
        properties.append(listed)
    vertex = [f"element vertex {len(cloud)}", *properties]
    faces = [[0, 1, 2, 3][: 3 + (i % 2 if d.mixed_faces else 0)] for i in range(5)]
    face = ["element face 5", f"property list {names['u1']} {names['i4']} vertex_indices"]
    if d.comments:
        vertex.insert(1, "obj_info in the middle")
        face.insert(0, "comment faces")
    elements = {"none": [vertex], "before": [face, vertex], "after": [vertex, face]}[d.faces]
    declared = [line for element in elements for line in element]
    header = ["ply", f"format {d.encoding} 1.0", *declared, "end_header", ""]
    body_vertex = _ply_vertices(columns, row_lists, d)
    body_face = b"".join(_list_bytes(f, d) + _end(d) for f in faces)
    bodies = {
        "none": [body_vertex],
        "before": [body_face, body_vertex],
        "after": [body_vertex, body_face],
    }[d.faces]
    return d.newline.join(header).encode() + b"".join(bodies) + d.trailing


def _ply_columns(cloud: PointCloud, d: PlyDialect) -> list[tuple[str, str, NDArray[np.generic]]]:
    columns = [(name, d.coordinates, cloud.points[:, i]) for i, name in enumerate("xyz")]
    if cloud.normals is not None:
        columns += [(f"n{a}", d.coordinates, cloud.normals[:, i]) for i, a in enumerate("xyz")]
    if cloud.colors is not None:
        scale = {"u1": 1, "u2": 257, "f4": 1 / 255, "f8": 1 / 255}[d.colors]
        scaled = cloud.colors * np.float64(scale)
        colors = [(name, d.colors, scaled[:, i]) for i, name in enumerate(d.color_names)]
        columns = colors + columns if d.colors_first else columns + colors
    return columns


def _order(d: PlyDialect) -> str:
    return ">" if d.encoding == "binary_big_endian" else "<"


def _end(d: PlyDialect) -> bytes:
    return d.newline.encode() if d.encoding == "ascii" else b""


def _list_bytes(values: list[int], d: PlyDialect) -> bytes:
    if d.encoding == "ascii":
        return " ".join(str(v) for v in [len(values), *values]).encode()
    return bytes([len(values)]) + np.array(values, dtype=_order(d) + "i4").tobytes()


def _ply_vertices(
    columns: list[tuple[str, str, NDArray[np.generic]]], lists: list[list[int]], d: PlyDialect
) -> bytes:
    rows = []
    for i, links in enumerate(lists):
        cells = []
        for _, kind, values in columns:
            value = np.array(values[i]).astype(_order(d) + kind)
            cells.append(repr(value.item()).encode() if d.encoding == "ascii" else value.tobytes())
        if d.vertex_list == "first":
            cells.insert(0, _list_bytes(links, d))
        elif d.vertex_list == "last":
            cells.append(_list_bytes(links, d))
        rows.append((b" " if d.encoding == "ascii" else b"").join(cells) + _end(d))
    return b"".join(rows)


@dataclass(frozen=True)
class TextDialect:
    """One way to write rows of text."""

    delimiter: str = " "
    newline: str = "\n"
    header: str = "none"  # none, plain, quoted, comment
    comments: bool = False
    count: bool = False
    mark: bool = False  # UTF-8 byte order mark
    quotes: bool = False  # around every value
    decimal_comma: bool = False
    blank_lines: bool = False
    exponents: bool = False
    intensity: bool = False
    normals_first: bool = True
    last_newline: bool = True


text_dialects = st.builds(
    TextDialect,
    delimiter=st.sampled_from([" ", "\t", "  ", ",", ", ", ";"]),
    newline=st.sampled_from(["\n", "\r\n", "\r"]),
    header=st.sampled_from(["none", "plain", "quoted", "comment"]),
    comments=st.booleans(),
    count=st.booleans(),
    mark=st.booleans(),
    quotes=st.booleans(),
    decimal_comma=st.booleans(),
    blank_lines=st.booleans(),
    exponents=st.booleans(),
    intensity=st.booleans(),
    normals_first=st.booleans(),
    last_newline=st.booleans(),
).filter(lambda d: not (d.decimal_comma and d.delimiter.startswith(",")))


def text_bytes(cloud: PointCloud, d: TextDialect) -> bytes:
    """The cloud as text rows."""
    names, cells = ["X", "Y", "Z"], [cloud.points]
    groups = []
    if cloud.normals is not None:
        groups.append((["Nx", "Ny", "Nz"], cloud.normals))
    if cloud.colors is not None:
        groups.append((["R", "G", "B"], cloud.colors))
    groups = groups if d.normals_first else groups[::-1]
    if d.intensity:  # as scanners write it: negative, so that it cannot be a colour
        groups.insert(0, (["Intensity"], np.full((len(cloud), 1), -1035)))
    for group, values in groups:
        names += group
        cells.append(values)
    rows = [[_number(v, d) for part in cells for v in part[i]] for i in range(len(cloud))]
    lines = [d.delimiter.join(f'"{v}"' if d.quotes else v for v in row) for row in rows]
    head = _text_head(names, len(cloud), d)
    if d.blank_lines:
        lines = [line for row in lines for line in (row, "")]
    if d.comments:
        lines.insert(1, "# in the middle")
    text = d.newline.join([*head, *lines])
    mark = b"\xef\xbb\xbf" if d.mark else b""
    return mark + (text + d.newline * d.last_newline).encode()


def _text_head(names: list[str], count: int, d: TextDialect) -> list[str]:
    head = ["# a comment", "// another"] if d.comments else []
    if d.header == "comment":
        head.append("//" + d.delimiter.join(names))
    elif d.header != "none":
        quote = '"' if d.header == "quoted" else ""
        head.append(d.delimiter.join(f"{quote}{name}{quote}" for name in names))
    if d.count:
        head.append(str(count))
    return head


def _number(value: np.generic, d: TextDialect) -> str:
    item = value.item()
    text = f"{item:.17e}" if d.exponents and isinstance(item, float) else repr(item)
    return text.replace(".", ",") if d.decimal_comma else text
