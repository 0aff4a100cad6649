"""Text clouds: what the columns are taken for, and what is wrong where."""

from __future__ import annotations

import io

import numpy as np
import pytest

from mpf_core.cloud.limits import Limits
from mpf_core.cloud.reader import read_stream
from mpf_core.cloud.reading import Reading
from mpf_core.errors import MPFError


def read(text: str | bytes, limits: Limits = Limits()) -> Reading:  # noqa: B008 - a frozen value
    data = text.encode() if isinstance(text, str) else text
    return read_stream(io.BytesIO(data), len(data), limits=limits)


def fails(text: str | bytes, limits: Limits = Limits()) -> MPFError:  # noqa: B008
    with pytest.raises(MPFError) as caught:
        read(text, limits)
    return caught.value


def meanings(text: str) -> list[str]:
    return [column.meaning for column in read(text).columns]


POINTS = ["x", "y", "z"]
NORMALS = ["normal x", "normal y", "normal z"]
COLORS = ["red", "green", "blue"]


@pytest.mark.parametrize(
    ("row", "expected", "warned"),
    [
        ("1 2 3", [], 0),
        ("1 2 3 0.5", ["intensity (left out)"], 0),
        ("1 2 3 0.5 7", ["left out", "left out"], 1),
        ("1 2 3 0.6 0.8 0", NORMALS, 0),
        ("1 2 3 9 8 255", COLORS, 0),
        ("1 2 3 0.5 0.2 0", COLORS, 1),
        ("1 2 3 -7 4 1.5", ["left out"] * 3, 1),
        ("1 2 3 -7 9 8 255", ["intensity (left out)", *COLORS], 0),
        ("1 2 3 9 8 7 255", [*COLORS, "left out"], 1),
        ("1 2 3 9 8 7 6", ["intensity (left out)", *COLORS], 1),
        ("1 2 3 0 0 1 9 8 7", [*NORMALS, *COLORS], 0),
        ("1 2 3 9 8 7 0 0 1", [*COLORS, *NORMALS], 0),
        ("1 2 3 0.7 9 8 7 0 0 1", ["intensity (left out)", *COLORS, *NORMALS], 0),
    ],
)
def test_unnamed_columns(row: str, expected: list[str], warned: int) -> None:
    found = read(f"{row}\n{row}\n")
    assert [c.meaning for c in found.columns] == [*POINTS, *expected]
    assert len(found.warnings) == warned
    assert len(found.cloud) == 2


def test_named_columns_in_any_order() -> None:
    found = read("Red;Green;Blue;Z [m];Y [m];X [m];Intensity\n1;2;3;30;20;10;7\n")
    np.testing.assert_array_equal(found.cloud.points, [[10, 20, 30]])
    assert found.cloud.colors is not None
    np.testing.assert_array_equal(found.cloud.colors, [[1, 2, 3]])
    assert meanings("Points:0,Points:1,Points:2,Normals:0,Normals:1,Normals:2\n1,2,3,0,0,1\n") == [
        *POINTS,
        *NORMALS,
    ]


def test_cloudcompare_header_and_count() -> None:
    found = read("//X Y Z R G B Nx Ny Nz\n2\n1 2 3 4 5 6 0 0 1\n1 2 3 4 5 6 0 0 1\n")
    assert [c.meaning for c in found.columns] == [*POINTS, *COLORS, *NORMALS]
    assert "leading count" in found.dialect


def test_header_of_unknown_words_is_warned_of() -> None:
    found = read("Alpha Beta Gamma\n1 2 3\n")
    assert len(found.cloud) == 1
    assert any("no names that are known" in warning for warning in found.warnings)


def test_surveyors_names() -> None:
    found = read("Point;Northing;Easting;Height\n1;20;10;30\n2;50;40;60\n")
    np.testing.assert_array_equal(found.cloud.points, [[10, 20, 30], [40, 50, 60]])
    assert not found.warnings


def test_rows_after_the_leading_count_are_left_out_with_a_warning() -> None:
    found = read("2\n1 2 3 7 8 9\n4 5 6 7 8 9\n7 8 9 7 8 9\n")
    np.testing.assert_array_equal(found.cloud.points, [[1, 2, 3], [4, 5, 6]])
    assert found.cloud.colors is not None and len(found.cloud.colors) == 2
    assert any("1 rows after them are left out" in warning for warning in found.warnings)


def test_a_column_that_may_number_the_points_is_warned_of() -> None:
    def warned(rows: str) -> bool:
        return any("column 1 counts the rows" in warning for warning in read(rows).warnings)

    assert warned("1 5 6 7\n2 8 9 1\n3 2 4 6\n")
    assert not warned("1 5 6 7\n2 8 9 1\n4 2 4 6\n")
    assert not warned("1 5 6\n2 8 9\n3 2 4\n")
    assert not warned("x,y,z,i\n1,5,6,7\n2,8,9,1\n3,2,4,6\n")


def test_decimal_commas() -> None:
    for text in ("1,5;2,5;3,5\n1;2;3\n", "1,5 2,5 3,5\n1 2 3\n", "1,5\t2,5\t3,5\n1\t2\t3\n"):
        np.testing.assert_array_equal(read(text).cloud.points, [[1.5, 2.5, 3.5], [1, 2, 3]])
        assert "decimal commas" in read(text).dialect


def test_delimiters_at_the_end_of_rows() -> None:
    np.testing.assert_array_equal(read("1,2,3,\n4,5,6,\n").cloud.points, [[1, 2, 3], [4, 5, 6]])
    assert len(read("1 2 3 \n4 5 6\t\n").cloud) == 2


def test_odd_numbers() -> None:
    found = read("1.0D+01 -1.#IND 3\n+.5 5. -nan(ind)\n")
    np.testing.assert_array_equal(found.cloud.points, [[10, np.nan, 3], [0.5, 5, np.nan]])


def test_normals_are_the_columns_nearest_to_unit_length() -> None:
    row = "0 0 0 2 255 0 -0.87238972 0.47377095 0.12032152\n"  # the blue 0 makes another candidate
    assert meanings(row) == [*POINTS, *COLORS, *NORMALS]


def test_points_then_normals() -> None:
    found = read("2\n1 2 3\n4 5 6\n0 0 1\n0 1 0\n")
    np.testing.assert_array_equal(found.cloud.points, [[1, 2, 3], [4, 5, 6]])
    assert found.cloud.normals is not None
    np.testing.assert_array_equal(found.cloud.normals, [[0, 0, 1], [0, 1, 0]])


@pytest.mark.parametrize(
    ("text", "code", "where"),
    [
        ("", "input.empty", None),
        ("# only words\n\n", "xyz.no_points", None),
        ("x y z\n", "xyz.no_points", None),
        ("Dear Sir,\n", "input.format_unknown", "line 1"),
        ("3\nwater\nO 0 0 0\nH 1 0 0\nH 0 1 0\n", "input.format_unknown", "line 3"),
        ("1 2\n3 4\n", "xyz.columns.too_few", "line 1"),
        ("1\n2\n3\n", "xyz.columns.too_few", "line 2"),
        ("1 2 3\n4 5 6\n7 8\n", "xyz.row.columns", "line 3"),
        ("1 2 3\n# x\n\n4 5 6 7\n", "xyz.row.columns", "line 4"),
        ("1 2 3\n4 five 6\n", "xyz.row.number", "line 2, column 2"),
        ("1,2,3\n4,,6\n", "xyz.row.number", "line 2, column 2"),
        ("1 2 3\n4 5 1_0\n", "xyz.row.number", "line 2, column 3"),
        ("1 2 x\n", "xyz.row.number", "line 1, column 3"),
        ("x,y,intensity\n1,2,3\n", "xyz.header.columns", "line 1"),
        ("3\n1 2 3\n4 5 6\n", "xyz.count.mismatch", None),
        ("x,y,z\n1,2,3,4\n1,2,3\n4,5,6\n", "xyz.row.columns", "line 2"),
        ("5000\n1 2 3\n4 5 6\n", "xyz.count.mismatch", None),
        ("99999999\n1 2 3\n", "cloud.too_large", None),
        (b"\xff\xfe1\x00 \x00", "xyz.encoding", None),
        (b"1 2 3\n\x00\x00", "input.format_unknown", "byte 6"),
        ("v 1 2 3\nv 1 2 3\n", "input.format_unknown", None),
        ("1 " * 200 + "\n", "xyz.columns.too_many", "line 1"),
        ("1 2 3\n" + "1" * 2_000_000, "xyz.line.too_long", "line 2"),
    ],
)
def test_faults_are_named_and_placed(text: str | bytes, code: str, where: str | None) -> None:
    error = fails(text)
    assert error.code == code
    if where is not None:
        assert error.where == where


def test_limits() -> None:
    assert fails("1 2 3\n" * 5, Limits(max_points=4)).code == "cloud.too_large"
    assert fails("1 2 3\n" * 5, Limits(max_bytes=20)).code == "input.too_large"
    assert len(read("1 2 3\n" * 5, Limits(max_points=5)).cloud) == 5
