"""PLY as tools write it, where the round trip does not reach."""

from __future__ import annotations

import io

import numpy as np
import pytest

from mpf_core.cloud.limits import Limits
from mpf_core.cloud.ply import read_ply
from mpf_core.cloud.reader import format_of
from mpf_core.cloud.reading import Reading
from mpf_core.errors import MPFError

XYZ = "property float x\nproperty float y\nproperty float z\n"


def ascii_ply(properties: str, *rows: str, count: int | None = None, after: str = "") -> bytes:
    count = len(rows) if count is None else count
    head = f"ply\nformat ascii 1.0\nelement vertex {count}\n{properties}{after}end_header\n"
    return (head + "".join(f"{row}\n" for row in rows)).encode()


def read(data: bytes, limits: Limits = Limits()) -> Reading:  # noqa: B008 - a frozen value
    assert format_of(data, len(data)) == "ply"
    return read_ply(io.BytesIO(data), len(data), limits)


def fails(data: bytes, limits: Limits = Limits()) -> MPFError:  # noqa: B008 - a frozen value
    with pytest.raises(MPFError) as caught:
        read(data, limits)
    return caught.value


def test_columns_are_named_with_their_meaning() -> None:
    found = read(ascii_ply(XYZ + "property float quality\nproperty uchar alpha\n", "1 2 3 4 5"))
    assert [(c.name, c.meaning) for c in found.columns] == [
        ("x", "x"),
        ("y", "y"),
        ("z", "z"),
        ("quality", "left out"),
        ("alpha", "alpha (left out)"),
    ]


@pytest.mark.parametrize(
    ("kind", "row", "color"),
    [
        ("uchar", "255 128 0", (255, 128, 0)),
        ("ushort", "65535 32896 0", (255, 128, 0)),
        ("ushort", "255 128 0", (255, 128, 0)),
        ("int", "255 128 0", (255, 128, 0)),
        ("float", "1 0.5019607843 0", (255, 128, 0)),
        ("double", "255.0 128.0 0", (255, 128, 0)),
    ],
)
def test_color_scales(kind: str, row: str, color: tuple[int, int, int]) -> None:
    properties = XYZ + "".join(f"property {kind} {c}\n" for c in ("red", "green", "blue"))
    colors = read(ascii_ply(properties, f"0 0 0 {row}")).cloud.colors
    assert colors is not None and tuple(colors[0]) == color


def test_colors_on_no_scale_are_left_out_with_a_warning() -> None:
    properties = XYZ + "".join(f"property float {c}\n" for c in ("red", "green", "blue"))
    found = read(ascii_ply(properties, "0 0 0 -1 900 0"))
    assert found.cloud.colors is None
    assert any("no known scale" in warning for warning in found.warnings)


def test_splats_have_base_colors_and_opacity() -> None:
    properties = XYZ + "".join(f"property float f_dc_{i}\n" for i in range(3))
    properties += "property float opacity\n"
    found = read(ascii_ply(properties, "0 0 0 0 0 0 5", "1 1 1 9 -9 1.7724539 -5"))
    assert found.cloud.colors is not None
    np.testing.assert_array_equal(found.cloud.colors, [[128, 128, 128], [255, 0, 255]])
    assert any("1 of 2 splats are nearly transparent" in w for w in found.warnings)


def test_normals_are_scaled_and_zeros_left_out() -> None:
    properties = XYZ + "".join(f"property float n{a}\n" for a in "xyz")
    found = read(ascii_ply(properties, "0 0 0 0 0 2", "1 1 1 0 0 0"))
    assert found.cloud.normals is not None
    np.testing.assert_array_equal(found.cloud.normals, [[0, 0, 1], [0, 0, 0]])
    assert read(ascii_ply(properties, "0 0 0 0 0 0")).cloud.normals is None


def test_unsigned_normals_and_half_colors_are_left_out_with_a_warning() -> None:
    properties = XYZ + "".join(f"property uchar n{a}\n" for a in "xyz") + "property uchar red\n"
    found = read(ascii_ply(properties, "0 0 0 1 2 3 4"))
    assert found.cloud.normals is None and found.cloud.colors is None
    assert len(found.warnings) == 2


def test_an_element_of_another_name_with_coordinates_is_taken() -> None:
    data = ascii_ply(XYZ, "1 2 3").replace(b"element vertex", b"element point")
    found = read(data)
    assert len(found.cloud) == 1
    assert "points in point" in found.dialect


def test_slips_of_well_known_tools_are_read() -> None:
    """A comment without its keyword (Blender 2.47), and the type of a yes or no (pyntcloud)."""
    data = ascii_ply(XYZ + "property bool seen\n", "1 2 3 1")
    data = data.replace(b"1.0\n", b"1.0\nCreated by Blender3D 247 - www.blender.org\n")
    assert [c.meaning for c in read(data).columns] == ["x", "y", "z", "left out"]
    np.testing.assert_array_equal(read(data).cloud.points, [[1, 2, 3]])


def test_a_utf8_mark_before_the_first_line_is_passed_over() -> None:
    data = b"\xef\xbb\xbf" + ascii_ply(XYZ, "1 2 3", "4 5 6")
    np.testing.assert_array_equal(read(data).cloud.points, [[1, 2, 3], [4, 5, 6]])


def test_a_mesh_is_said_to_be_one() -> None:
    faces = "element face 1\nproperty list uchar int vertex_indices\n"
    found = read(ascii_ply(XYZ, *["1 2 3"] * 3, "3 0 1 2", count=3, after=faces))
    assert len(found.cloud) == 3 and not found.warnings
    assert any("the file is a mesh: its vertices" in note for note in found.cloud.notes)


def test_compressed_splats_are_named() -> None:
    error = fails(ascii_ply("property uint packed_position\n", "1"))
    assert error.code == "ply.vertex.coordinates"
    assert error.advice is not None and "uncompressed" in error.advice


def test_trailing_bytes_are_said() -> None:
    assert any("2 lines after" in w for w in read(ascii_ply(XYZ, "1 2 3") + b"x\ny\n").warnings)


def test_carriage_returns_alone_end_lines_too() -> None:
    data = ascii_ply(XYZ, "1 2 3", "4 5 6").replace(b"\n", b"\r")
    np.testing.assert_array_equal(read(data).cloud.points, [[1, 2, 3], [4, 5, 6]])


def test_data_that_starts_with_a_newline_byte_stays_whole() -> None:
    point = b"\n\xd7#<" * 3
    for end in ("\n", "\r\n"):
        head = f"ply\nformat binary_little_endian 1.0\nelement vertex 1\n{XYZ}end_header\n"
        found = read(head.replace("\n", end).encode() + point)
        assert found.cloud.points[0, 0] == pytest.approx(0.01)
        assert not found.warnings


def test_a_signalling_nan_is_a_nan_like_others() -> None:
    header = b"ply\nformat binary_big_endian 1.0\nelement vertex 1\n"
    header += b"property float x\nproperty float y\nproperty float z\nend_header\n"
    points = read(header + bytes.fromhex("7f800001") + bytes(8)).cloud.points
    np.testing.assert_array_equal(points, [[np.nan, 0, 0]])


def test_a_list_that_is_never_empty_among_the_vertices() -> None:
    data = ascii_ply("property list uchar int n\n" + XYZ, "2 7 8 1 2 3", "0 4 5 6")
    np.testing.assert_array_equal(read(data).cloud.points, [[1, 2, 3], [4, 5, 6]])
    error = fails(ascii_ply("property list uchar int n\n" + XYZ, "2 7 8 1 2"))
    assert (error.code, error.where) == ("ply.row.columns", "line 9")
    assert fails(ascii_ply("property list uchar int n\n" + XYZ, "-2 7 1 2")).code == (
        "ply.list.length"
    )


@pytest.mark.parametrize(
    ("data", "code", "where"),
    [
        (b"ply\n", "ply.header.truncated", "line 1"),
        (b"ply\ncomment x\n", "ply.format.missing", "line 2"),
        (b"ply\nformat ascii 2.0\n", "ply.format.unsupported", "line 2"),
        (b"ply\nformat text 1.0\n", "ply.format.unsupported", "line 2"),
        (b"ply\nformat ascii 1.0\nelement vertex x\n", "ply.element.count", "line 3"),
        (
            b"ply\nformat ascii 1.0\nelement a 1\nelement a 1\n",
            "ply.element.duplicate",
            "line 4",
        ),
        (ascii_ply("property list float int x\n"), "ply.property.type", "line 4"),
        (ascii_ply("property half x\n"), "ply.property.type", "line 4"),
        (ascii_ply(XYZ + "property float x\n"), "ply.property.duplicate", "line 3"),
        (ascii_ply("property list uchar float x\n" + XYZ[17:]), "ply.vertex.coordinates", "line 3"),
        (ascii_ply("property float x\n", "1"), "ply.vertex.coordinates", "line 3"),
        (ascii_ply("property float x\n").replace(b"vertex", b"face"), "ply.vertex.missing", None),
        (ascii_ply(XYZ, "1 2 3", count=2), "ply.count.mismatch", None),
        (ascii_ply(XYZ, "1 2 3.00000000", count=2), "ply.count.mismatch", "after line 8"),
        (ascii_ply(XYZ, "1 2 3", "1 2 3 4"), "ply.row.columns", "line 9"),
        (ascii_ply(XYZ, "1 2 3", "", "1 2", count=2), "ply.row.columns", "line 10"),
        (ascii_ply(XYZ, "1 two 3"), "ply.row.number", "line 8, column 2"),
        (b"ply\nproperty float x\n", "ply.format.missing", "line 2"),
        (b"ply\nformat ascii 1.0\nproperty float x\n", "ply.header.line", "line 3"),
        (b"ply\nformat ascii 1.0\n" + b"comment\n" * 9000, "ply.header.too_long", None),
    ],
)
def test_faults_are_named_and_placed(data: bytes, code: str, where: str | None) -> None:
    error = fails(data)
    assert error.code == code
    if where is not None:
        assert error.where == where


def test_limits() -> None:
    data = ascii_ply(XYZ, "1 2 3", "4 5 6", after="element face 9\nproperty list uchar int i\n")
    assert fails(data, Limits(max_points=1)).code == "cloud.too_large"
    assert fails(data, Limits(max_rows=8)).code == "ply.rows.too_many"
