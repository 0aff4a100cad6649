"""How long reading takes, beside the readers that others use.

    python benchmarks/readers.py [--points 3000000] [--folder DIR]

Prints a Markdown table: seconds of one core (best of three where the first takes less than ten,
file in the cache) and peak memory as a multiple of the arrays that come back. Each measurement is
a process of its own on one core of a Linux machine; the seconds are the processor's, so that what
else runs there counts little. plyfile, trimesh, Open3D and numpy take part where installed.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

READERS = {
    "mpf": "from mpf_core.cloud.reader import read_cloud\n"
    "def load(path):\n"
    "    c = read_cloud(path)\n"
    "    return [a for a in (c.points, c.normals, c.colors) if a is not None]",
    "plyfile": "import numpy as np\nfrom plyfile import PlyData\n"
    "def load(path):\n"
    "    v = PlyData.read(path)['vertex']\n"
    "    return [np.stack([v[a] for a in 'xyz'], axis=1).astype(np.float64)]",
    "trimesh": "import trimesh\n"
    "def load(path):\n"
    "    return [trimesh.load(path, process=False).vertices]",
    "Open3D": "import numpy as np\nimport open3d\n"
    "def load(path):\n"
    "    return [np.asarray(open3d.io.read_point_cloud(path).points)]",
    "numpy.loadtxt": "import numpy as np\ndef load(path):\n    return [np.loadtxt(path)]",
}

MEASURE = """
import json, os, re, sys, time
from pathlib import Path
if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
%s
# Not ru_maxrss, which starts at the size of the parent that this process was forked from.
status = lambda: Path("/proc/self/status").read_text()
peak = lambda: int(re.search(r"VmHWM:\\s+(\\d+)", status())[1])
load(sys.argv[1])
before, best = peak(), 1e9
for turn in range(3):
    start = time.process_time()
    arrays = load(sys.argv[2])
    best = min(best, time.process_time() - start)
    if turn == 0:
        memory = (peak() - before) * 1024 / sum(a.nbytes for a in arrays)
    n = len(arrays[0])
    del arrays
    if best > 10:
        break
print(json.dumps([best, memory, n]))
"""


def write_clouds(folder: Path, points: int) -> dict[str, list[str]]:
    """The clouds by name, each with the readers that know its format; `small-` ones warm up."""
    rng = np.random.default_rng(0)
    for prefix, n in (("small-", 1000), ("", points)):
        xyz = rng.normal(size=(n, 3))
        rgb = rng.integers(0, 256, (n, 3), dtype=np.uint8)
        _write_binary(folder / f"{prefix}binary.ply", xyz)
        _write_colored(folder / f"{prefix}colored.ply", xyz, rgb)
        _write_text(folder / f"{prefix}text.xyz", xyz)
        body = (folder / f"{prefix}text.xyz").read_bytes()
        (folder / f"{prefix}ascii.ply").write_bytes(_header("ascii", n, "float", False) + body)
    ply = ["mpf", "plyfile", "trimesh", "Open3D"]
    return {
        "binary.ply": ply,
        "colored.ply": ply,
        "ascii.ply": ply,
        "text.xyz": ["mpf", "numpy.loadtxt", "trimesh", "Open3D"],
    }


def _header(encoding: str, n: int, kind: str, colored: bool) -> bytes:
    properties = [f"property {kind} {axis}" for axis in "xyz"]
    if colored:
        properties += [f"property uchar {color}" for color in ("red", "green", "blue")]
    lines = ["ply", f"format {encoding} 1.0", f"element vertex {n}", *properties, "end_header", ""]
    return "\n".join(lines).encode()


def _write_binary(path: Path, xyz: np.ndarray) -> None:
    header = _header("binary_little_endian", len(xyz), "float", False)
    path.write_bytes(header + xyz.astype("<f4").tobytes())


def _write_colored(path: Path, xyz: np.ndarray, rgb: np.ndarray) -> None:
    rows = np.empty(len(xyz), np.dtype([("p", "<f8", 3), ("c", "u1", 3)]))
    rows["p"], rows["c"] = xyz, rgb
    header = _header("binary_little_endian", len(xyz), "double", True)
    path.write_bytes(header + rows.tobytes())


def _write_text(path: Path, xyz: np.ndarray) -> None:
    with path.open("w") as out:
        for part in np.array_split(xyz, max(1, len(xyz) // 100_000)):
            out.write(("%.6f %.6f %.6f\n" * len(part)) % tuple(part.ravel().tolist()))


def measure(reader: str, folder: Path, name: str) -> tuple[float, float, int] | None:
    """Core seconds, memory per array and points; None where the reader is missing or fails."""
    told = subprocess.run(  # noqa: S603 - this interpreter and the code above
        [
            sys.executable,
            "-c",
            MEASURE % READERS[reader],
            str(folder / f"small-{name}"),
            str(folder / name),
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    if told.returncode:
        return None
    seconds, memory, n = json.loads(told.stdout.splitlines()[-1])
    return seconds, memory, n


def main() -> None:
    """Writes the clouds, measures every reader on them, prints the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--points", type=int, default=3_000_000)
    parser.add_argument("--folder", type=Path)
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=chosen.folder) as name:
        folder = Path(name)
        out = sys.stdout
        out.write(f"| file of {chosen.points:,} points | MB | reader | core seconds | memory |\n")
        out.write("| --- | ---: | --- | ---: | ---: |\n")
        for cloud, readers in write_clouds(folder, chosen.points).items():
            size = (folder / cloud).stat().st_size / 1e6
            for reader in readers:
                found = measure(reader, folder, cloud)
                figures = "– | –" if found is None else f"{found[0]:.2f} | {found[1]:.1f} ×"
                out.write(f"| {cloud} | {size:.0f} | {reader} | {figures} |\n")
                out.flush()


if __name__ == "__main__":
    main()
