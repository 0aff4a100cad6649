"""One fit of a large cloud against tiles of it: `mpf experiment tiles`.

The cloud is of a surface whose relief one network cannot hold. Both are `mpf reconstruct` in a
process of its own with the same options, so each tile is given what the single fit is given; the
mesh of the networks alone, before the last step, is what `mpf extract` takes from the kept field.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpf_core.cloud.pointcloud import PointCloud
from mpf_core.experiments.asked import Asked
from mpf_core.experiments.scaling import Cost, command
from mpf_core.experiments.shapes import sample, shape
from mpf_core.experiments.trial import Row
from mpf_core.field.blend import BlendedField
from mpf_core.field.blendfile import load_field
from mpf_core.files import write_atomically
from mpf_core.quality.meshio import read_mesh
from mpf_core.quality.metrics import compare, point_distances
from mpf_core.quality.sampling import sample_surface
from mpf_core.quality.topology import topology
from mpf_core.surface.export import cloud_ply_bytes
from mpf_core.surface.mesh import Mesh

SHAPE = "knurled-ring"
POINTS = 3_000_000  # as many as the paper's real scan has
ITERATIONS = 1000
# Of the quick form: a shape of few triangles, fitted by a small network.
QUICK_SHAPE, QUICK_POINTS = "plate-0.1", 2000
QUICK: Row = {
    "tile_points": 1200, "width": 32, "omega": 15.0, "start_points": 256, "resolution": 32,
}  # fmt: skip

Array = NDArray[np.float64]


def measured(directory: Path, asked: Asked) -> list[Row]:
    """A row for the single fit, one for the tiles; meshes and fields stay in `directory`, and rows
    that are there are kept."""
    directory.mkdir(parents=True, exist_ok=True)
    cloud = directory / "cloud.ply"
    if not cloud.is_file():
        points = sample(QUICK_SHAPE, QUICK_POINTS) if asked.quick else sample(SHAPE, POINTS)
        write_atomically(cloud, cloud_ply_bytes(PointCloud(points), []))
    own: Row = {"preset": "draft", "max_iterations": ITERATIONS, "time_budget": 86_400.0}
    if asked.quick:
        own = QUICK
    options = asked.options(own) | {"slices": 0}
    rows = []
    for name, tiles in (("one fit", "off"), ("tiles", "auto")):
        folder = directory / name.replace(" ", "-")
        folder.mkdir(exist_ok=True)
        kept = folder / "row.json"
        if not kept.is_file():
            row = _row(name, cloud, folder, options | {"tiles": tiles}, asked.quick)
            write_atomically(kept, json.dumps(row, indent=2).encode())
        rows.append(json.loads(kept.read_text()))
    return rows


def _row(name: str, cloud: Path, folder: Path, options: Row, quick: bool) -> Row:
    field, mesh, alone = folder / "field.safetensors", folder / "mesh.ply", folder / "alone.ply"
    flags = ["-o", str(mesh), "--field", str(field), "--report", str(folder / "report.json")]
    flags += ["--checkpoint", str(folder / "checkpoint")]
    for option, value in options.items():
        flags += ["--set", f"{option}={json.dumps(value)}"]
    fit = command(["reconstruct", str(cloud), *flags], folder)
    again = ["--resolution", str(options["resolution"])] if "resolution" in options else []
    taken = command(["extract", str(field), "-o", str(alone), *again], folder)
    report = json.loads((folder / "report.json").read_text())
    return {
        "what": name,
        "tiles": report.get("tiles", {}).get("count", 1),
        **_errors(read_mesh(alone), "alone ", quick),
        **_errors(read_mesh(mesh), "", quick),
        **_costs(fit, taken),
        "iterations": report["fit"]["iterations"],
        "resolution": report["extraction"]["resolution"],
        "field MiB": field.stat().st_size / 2**20,
        **_seams(read_mesh(alone), field, "alone ", quick),
        **_seams(read_mesh(mesh), field, "", quick),
    }


def _costs(fit: Cost, taken: Cost) -> Row:
    return {
        "seconds": fit.seconds,
        "processor seconds": fit.busy,
        "peak MiB": fit.peak,
        "extract: seconds": taken.seconds,
        "extract: peak MiB": taken.peak,
    }


def _errors(mesh: Mesh, of: str, quick: bool) -> Row:
    """Against the exact surface, in the cloud's frame, which is the shape's."""
    found = compare(mesh, _exact(quick), samples=10_000 if quick else 200_000)
    counts = topology(mesh)
    return {
        f"{of}Chamfer × 10³": found.chamfer,
        f"{of}normal consistency": found.normal_consistency,
        f"{of}largest error": found.hausdorff,
        f"{of}faces": counts.faces,
        f"{of}components": counts.components,
        f"{of}boundary edges": counts.boundary_edges,
    }


def _seams(mesh: Mesh, field: Path, of: str, quick: bool) -> Row:
    """Mean error × 10³ where two tiles or more have weight, within a spacing of a cut, and where
    one tile is alone."""
    blend = load_field(field)
    if not isinstance(blend, BlendedField):
        return {}
    points = sample_surface(mesh, 10_000 if quick else 200_000, np.random.default_rng(0)).points
    error = 1e3 * point_distances(points, _exact(quick))
    at = blend.similarity.to_normalised(points)
    most = np.zeros(len(at))
    for share in blend.partition.shares(at):
        most[share.rows] = np.maximum(most[share.rows], share.weights)
    within = _distance_to_cuts(blend, at) < blend.footprint.spacing
    told = {"in ramps": most < 1, "at cuts": within, "elsewhere": most == 1}
    return {f"{of}error {where}": _mean(error[rows]) for where, rows in told.items()}


def _exact(quick: bool) -> Mesh:
    return shape(QUICK_SHAPE if quick else SHAPE)


def _mean(values: Array) -> Any:
    return float(values.mean()) if len(values) else None


def _distance_to_cuts(blend: BlendedField, x: Array) -> Array:
    """(n,) from points (n, 3) of the whole's frame to the nearest inner face of their core."""
    far = 10.0
    distance = np.full(len(x), far)
    for low, high in blend.partition.boxes(np.array([[-far] * 3, [far] * 3])):
        own = ((x >= low) & (x < high)).all(1)
        distance[own] = np.minimum(x[own] - low, high - x[own]).min(1)
    return distance
