"""Damage of any kind to a valid file ends in points or a typed error, soon, in little memory."""

from __future__ import annotations

import io
import re
import subprocess
import sys
import time
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mpf_core.cloud.limits import HEADER_BYTES
from mpf_core.cloud.pointcloud import PointCloud
from mpf_core.cloud.reader import peek_header, read_stream
from mpf_core.errors import InputError

from .dialects import (
    clouds,
    ply_bytes,
    ply_dialects,
    text_bytes,
    text_dialects,
)

SECONDS = 2.0
BYTES = 512 * 1024**2


def survive(data: bytes) -> PointCloud | InputError:
    """The cloud or the typed error; anything else escapes and fails the test."""
    start = time.process_time()
    result: PointCloud | InputError
    try:
        peek_header(data[:HEADER_BYTES], len(data))
    except InputError as error:
        assert error.code and error.advice
    try:
        result = read_stream(io.BytesIO(data), len(data)).cloud
    except InputError as error:
        assert "." in error.code and error.advice
        result = error
    assert time.process_time() - start < SECONDS
    return result


valid_files = st.one_of(
    st.builds(ply_bytes, clouds(single=True), ply_dialects),
    st.builds(text_bytes, clouds(least=1), text_dialects),
)


@settings(max_examples=300, deadline=None)
@given(valid_files, st.data())
def test_bits_flipped(data: bytes, draws: st.DataObject) -> None:
    damaged = bytearray(data)
    for _ in range(draws.draw(st.integers(1, 8))):
        place = draws.draw(st.integers(0, len(damaged) - 1))
        damaged[place] ^= 1 << draws.draw(st.integers(0, 7))
    survive(bytes(damaged))


@settings(max_examples=200, deadline=None)
@given(valid_files, st.data())
def test_cut_doubled_and_filled(data: bytes, draws: st.DataObject) -> None:
    first = draws.draw(st.integers(0, len(data)))
    last = draws.draw(st.integers(first, len(data)))
    survive(data[:first])
    survive(data[:first] + data[last:])
    survive(data[:last] + data[first:])
    survive(data[:first] + draws.draw(st.binary(max_size=40)) + data[first:])


@settings(max_examples=200, deadline=None)
@given(valid_files, st.data())
def test_counts_and_numbers_lie(data: bytes, draws: st.DataObject) -> None:
    numbers = list(re.finditer(rb"(?<=[\s,;])\d+(?=[\s,;])", data))
    if not numbers:
        return
    found = draws.draw(st.sampled_from(numbers))
    lie = draws.draw(
        st.sampled_from(
            [b"0", b"-1", b"9999999", b"4294967295", b"1e400", b"nan", b"0x10", b"9" * 99]
        )
    )
    survive(data[: found.start()] + lie + data[found.end() :])


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=400))
def test_anything_at_all(data: bytes) -> None:
    survive(data)
    survive(b"ply\n" + data)
    survive(b"ply\nformat ascii 1.0\nelement vertex 2\n" + data)


CUBE = "property float x\nproperty float y\nproperty float z\n"
HEAD = "ply\nformat binary_little_endian 1.0\n"


@pytest.mark.parametrize(
    "data",
    [
        (HEAD + f"element vertex 9999999\n{CUBE}end_header\n").encode() + bytes(1200),
        (HEAD + "element vertex 9999999\nend_header\n").encode(),
        (HEAD + f"element junk 49999999\nelement vertex 0\n{CUBE}end_header\n").encode(),
        (HEAD + f"element vertex 1\nproperty list uint double a\n{CUBE}end_header\n").encode()
        + b"\xff" * 40,
        (
            HEAD + f"element face 3000000\nproperty list uchar uchar a\nelement vertex 1\n{CUBE}"
            "end_header\n"
        ).encode()
        + b"\x00\x01\x07" * 1_500_000
        + bytes(12),
        b"9999999\n" + b"0 0 0\n" * 99,
        b"1 2 3\n" + b"\n" * 5_000_000,
        b"1 2 3\n" + b" " * 5_000_000,
        b"1 2 3\n" + b"#\n" * 1_000_000,
        b"1 2 3\n//\n!\n %\n" * 200_000,
        b"1.D0 '2' -1.#IND\n" * 60_000,
        b"ply\nformat ascii 1.0\nelement vertex 1\n"
        + f"{CUBE}end_header\n".encode()
        + b"\n" * 4_000_000
        + b"1 2 3\n",
        b"1," * 500_000,
        b"0 0 0\n" * 500_000 + b"0 0\n",
        b"\r" * 3_000_000,
        b"1" * 3_000_000,
        b"ply\r" + b"comment \r" * 300_000,
    ],
    ids=range(17),
)
def test_small_files_that_ask_for_much(data: bytes) -> None:
    """Time and memory are bounded by the file, whatever it declares."""
    survive(data)
    if len(data) > 10_000:  # every allocation is traced: too slow for the long ones
        return
    tracemalloc.start()
    try:
        read_stream(io.BytesIO(data), len(data))
    except InputError:
        pass
    finally:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert peak < BYTES


MEASURE = """
import re, sys
from pathlib import Path
from mpf_core.cloud.reader import read_cloud
# Not ru_maxrss, which starts at the size of the parent that this process was forked from.
status = lambda: Path("/proc/self/status").read_text()
peak = lambda: int(re.search(r"VmHWM:\\s+(\\d+)", status())[1])
read_cloud(sys.argv[1])
before = peak()
cloud = read_cloud(sys.argv[2])
arrays = [a.nbytes for a in (cloud.points, cloud.normals, cloud.colors) if a is not None]
print((peak() - before) * 1024 / sum(arrays))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize("kind", ["text", "text with all", "binary"])
def test_memory_is_at_most_three_arrays(tmp_path: Path, kind: str) -> None:
    """The largest resident size while a process reads a big cloud, beyond what a small one took."""
    n = 400_000
    rows: dict[str, tuple[str, bytes]] = {
        "text": ("", b"0.123456 -1.234567 12.345678\n"),
        "text with all": ("", b"0.123456 -1.234567 12.345678 0 0.6 0.8 1 2 255\n"),
        "binary": (
            "ply\nformat binary_little_endian 1.0\nelement vertex {n}\nproperty float x\n"
            "property float y\nproperty float z\nproperty uchar red\nproperty uchar green\n"
            "property uchar blue\nend_header\n",
            np.array([1, 2, 3], "<f4").tobytes() + b"\x01\x02\x03",
        ),
    }
    head, row = rows[kind]
    for name, count in (("small", 40_000), ("big", n)):
        (tmp_path / name).write_bytes(head.format(n=count).encode() + row * count)
    paths = [str(tmp_path / name) for name in ("small", "big")]
    told = subprocess.run(
        [sys.executable, "-c", MEASURE, *paths], capture_output=True, text=True, check=True
    )
    assert float(told.stdout) < 3
