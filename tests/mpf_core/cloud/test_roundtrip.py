"""Any cloud, written in any dialect, reads back as the same arrays."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from mpf_core.cloud.pointcloud import PointCloud
from mpf_core.cloud.reader import read_stream
from mpf_core.cloud.reading import Reading
from mpf_core.cloud.textrows import BLOCK_BYTES

from .dialects import (
    PlyDialect,
    TextDialect,
    clouds,
    ply_bytes,
    ply_dialects,
    text_bytes,
    text_dialects,
)


def read_bytes(data: bytes) -> Reading:
    return read_stream(io.BytesIO(data), len(data))


def assert_same(found: PointCloud, cloud: PointCloud) -> None:
    np.testing.assert_array_equal(found.points, cloud.points)
    for got, expected in ((found.normals, cloud.normals), (found.colors, cloud.colors)):
        assert (got is None) == (expected is None)
        if expected is not None:
            np.testing.assert_array_equal(got, expected)
    assert found.points.dtype == np.float64 and found.points.flags.c_contiguous


@settings(max_examples=150, deadline=None)
@given(st.data(), ply_dialects)
def test_ply(data: st.DataObject, dialect: PlyDialect) -> None:
    cloud = data.draw(clouds(single=dialect.coordinates == "f4"))
    reading = read_bytes(ply_bytes(cloud, dialect))
    assert reading.format == "ply"
    assert_same(reading.cloud, cloud)


@settings(max_examples=150, deadline=None)
@given(clouds(least=1), text_dialects)
def test_text(cloud: PointCloud, dialect: TextDialect) -> None:
    reading = read_bytes(text_bytes(cloud, dialect))
    assert reading.format == "xyz"
    assert_same(reading.cloud, cloud)


def test_text_across_blocks() -> None:
    """More rows than one block holds, with a comment and odd spellings in a late one."""
    rng = np.random.default_rng(0)
    cloud = PointCloud(rng.normal(size=(40_000, 3)))
    plain = text_bytes(cloud, TextDialect())
    assert len(plain) > 2 * BLOCK_BYTES
    for newline in (b"\n", b"\r", b"\r\n"):
        data = plain.replace(b"\n", newline)
        assert_same(read_bytes(data).cloud, cloud)
    middle = data.index(b"\r\n", len(data) // 2) + 2
    data = data[:middle] + b"# note\r\n1.0D+00 nan(ind) -1.#INF\r\n" + data[middle:]
    found = read_bytes(data).cloud
    assert len(found) == 40_001
    assert int(np.isnan(found.points).any(axis=1).sum()) == 1


def test_binary_ply_across_pieces() -> None:
    """Mixed faces before, and lists of varying length among, more vertices than one piece holds."""
    rng = np.random.default_rng(0)
    cloud = PointCloud(
        rng.normal(size=(200_000, 3)), colors=rng.integers(0, 256, (200_000, 3), dtype=np.uint8)
    )
    d = PlyDialect(encoding="binary_little_endian")
    plain = ply_bytes(PointCloud(cloud.points[:0], colors=cloud.colors[:0]), d)
    assert cloud.colors is not None
    row = np.dtype([("p", "<f8", 3), ("c", "u1", 3)])
    rows = np.empty(len(cloud), row)
    rows["p"], rows["c"] = cloud.points, cloud.colors
    header = plain.replace(b"vertex 0", b"vertex 200000")
    assert_same(read_bytes(header + rows.tobytes()).cloud, cloud)

    small = PointCloud(cloud.points[:5000])
    for order in ("binary_little_endian", "binary_big_endian"):
        for where in ("first", "last"):
            mixed = replace(d, encoding=order, vertex_list=where, faces="before", mixed_faces=True)
            assert_same(read_bytes(ply_bytes(small, mixed)).cloud, small)


def test_more_faces_than_a_piece_before_the_vertices() -> None:
    points = np.random.default_rng(1).normal(size=(100, 3))
    lengths = np.tile([3, 4], 200_000)
    body = b"\x03" + bytes(12) + b"\x04" + bytes(16)
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element face {len(lengths)}\nproperty list uchar int vertex_indices\n"
        "element vertex 100\nproperty double x\nproperty double y\nproperty double z\nend_header\n"
    )
    data = header.encode() + body * 200_000 + points.tobytes()
    np.testing.assert_array_equal(read_bytes(data).cloud.points, points)
