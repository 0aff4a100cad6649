"""The front: paths, formats by content, headers without bodies, and `mpf inspect`."""

from __future__ import annotations

import json
import os
import socket
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from mpf_core.cloud.cli import inspect
from mpf_core.cloud.errors import error_codes
from mpf_core.cloud.inspection import inspect_cloud
from mpf_core.cloud.limits import HEADER_BYTES, Limits
from mpf_core.cloud.pointcloud import PointCloud
from mpf_core.cloud.reader import HeaderFacts, peek_header, read_cloud
from mpf_core.errors import MPFError

from .dialects import PlyDialect, TextDialect, ply_bytes, text_bytes

POINTS = np.random.default_rng(0).normal(size=(80, 3))
CLOUD = PointCloud(POINTS, colors=np.arange(240, dtype=np.uint8).reshape(80, 3))
PLY = ply_bytes(CLOUD, PlyDialect("binary_little_endian"))
TEXT = text_bytes(CLOUD, TextDialect(count=True))


def code_of(path: Path | str) -> str:
    with pytest.raises(MPFError) as caught:
        read_cloud(path)
    assert str(path) not in str(caught.value) or str(path) == caught.value.where
    return caught.value.code


@pytest.mark.parametrize("name", ["a.ply", "a.xyz", "a.txt", "a", "a.obj", "a.xyz.gz"])
def test_the_content_decides_whatever_the_name(tmp_path: Path, name: str) -> None:
    for data in (PLY, TEXT):
        (tmp_path / name).write_bytes(data)
        np.testing.assert_array_equal(read_cloud(tmp_path / name).points, POINTS)


def test_paths_that_are_no_files(tmp_path: Path) -> None:
    assert code_of(tmp_path / "missing.ply") == "input.unreadable"
    assert code_of(tmp_path) == "input.unreadable"
    os.mkfifo(tmp_path / "pipe")
    assert code_of(tmp_path / "pipe") == "input.unreadable"
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(tmp_path / "socket"))
        assert code_of(tmp_path / "socket") == "input.unreadable"
    assert code_of("http://example.org/cloud.xyz") == "input.unreadable"


@pytest.mark.parametrize(
    "data",
    [
        b"\x1f\x8b\x08rest",
        b"PK\x03\x04",
        b"solid x",
        b"# .PCD v0.7\n1 2 3\n",
        b"LASF",
        b"{}",
        b"<a>",
        b"ncols 4\nnrows 2\n",
        b"VERSION .7\nFIELDS x y z\n1 2 3\n",
    ],
)
def test_other_formats_are_named_and_never_opened(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "cloud.xyz").write_bytes(data)
    assert code_of(tmp_path / "cloud.xyz") == "input.format_unknown"


def test_the_header_alone() -> None:
    assert peek_header(PLY, len(PLY)) == HeaderFacts("ply", 80, complete=True)
    assert peek_header(PLY[:400], None) == HeaderFacts("ply", 80, complete=True)
    assert peek_header(PLY[:40], None) == HeaderFacts("ply", None, complete=False)
    assert peek_header(PLY[:40], len(PLY)) == HeaderFacts("ply", None, complete=False)
    assert peek_header(TEXT, len(TEXT)) == HeaderFacts("xyz", 80, complete=True)
    assert peek_header(TEXT[:40], len(TEXT)) == HeaderFacts("xyz", None, complete=False)
    rows = b"1 2 3\n" * 20_000
    assert peek_header(rows[:HEADER_BYTES], None) == HeaderFacts("xyz", None, complete=True)


@pytest.mark.parametrize(
    ("first", "size", "code"),
    [
        (b"", 0, "input.empty"),
        (PLY[:400], 500, "ply.count.mismatch"),
        (PLY.replace(b"vertex 80", b"vertex 20000000")[:400], None, "cloud.too_large"),
        (PLY.replace(b"vertex 80", b"vertex 50")[:400], None, "cloud.too_small"),
        (TEXT[:40] * 2000, 10**12, "input.too_large"),
        (b"20000000\n" + TEXT[3:] * 30, None, "cloud.too_large"),
        (b"GIF89a\0\0" * 9000, None, "input.format_unknown"),
    ],
)
def test_the_header_alone_refuses(first: bytes, size: int | None, code: str) -> None:
    with pytest.raises(MPFError) as caught:
        peek_header(first[:HEADER_BYTES], size, limits=Limits())
    assert caught.value.code == code


def test_codes_are_unique_and_described() -> None:
    codes = error_codes()
    assert len(codes) >= 30
    assert all(line.endswith(".") and "." in code for code, line in codes.items())
    text = (Path(__file__).parents[3] / "docs" / "formats.md").read_text(encoding="utf-8")
    table = text[text.index("| code | when |") :].splitlines()[2:]
    assert table == [f"| `{code}` | {line} |" for code, line in codes.items()]


def test_inspection_says_what_was_found(tmp_path: Path) -> None:
    path = tmp_path / "cloud.ply"
    path.write_bytes(PLY + b"more")
    found = inspect_cloud(path, name="upload.ply")
    assert (found.file, found.format, found.points, found.colors) == ("upload.ply", "ply", 80, True)
    assert found.low is not None and found.low == tuple(POINTS.min(axis=0))
    assert found.preparation is not None and found.preparation.kept == 80
    assert found.warnings == ("4 bytes after the last element are left out",)
    assert json.loads(json.dumps(found.as_dict()))["columns"][0] == {"name": "x", "meaning": "x"}


def test_inspect_command(tmp_path: Path) -> None:
    path = tmp_path / "cloud.csv"
    path.write_bytes(TEXT)
    told = CliRunner().invoke(inspect, [str(path)])
    assert told.exit_code == 0
    assert "leading count" in told.output and "spacing" in told.output
    told = CliRunner().invoke(inspect, [str(path), "--json"])
    assert (told.exit_code, json.loads(told.output)["points"]) == (0, 80)
    path.write_bytes(b"1 2 3\n4 5\n")
    told = CliRunner().invoke(inspect, [str(path), "--json"])
    assert told.exit_code == 2
    assert json.loads(told.output).keys() == {"code", "message", "where", "advice"}
    told = CliRunner().invoke(inspect, [str(path)])
    assert told.exit_code == 2
    assert "xyz.row.columns" in told.stderr and "line 2" in told.stderr


def test_inspecting_too_few_points_is_a_warning(tmp_path: Path) -> None:
    path = tmp_path / "few.xyz"
    path.write_bytes(b"1 2 3\nnan 5 6\n")
    found = inspect_cloud(path)
    assert found.points == 2 and found.low == found.high == (1.0, 2.0, 3.0)
    assert found.preparation is None and "cloud.too_small" in found.warnings[-1]
