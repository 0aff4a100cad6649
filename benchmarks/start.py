"""Whether the classical start of a fit is right: the sign of θ* and the surface {θ* = 0}.

    python benchmarks/start.py [--only plate] [--no-mesh] [--meshes DIR]

Prints a Markdown table, one row a cloud: the share of wrong signs at random points inside and
outside within 0.01 … 0.1 of the exact surface (of thin walls: anywhere between them), and far
from it; then the Chamfer distance × 10³ (`mpf evaluate`), the components and the closedness of
the surface that the targets alone make. No network takes part. What is open is outside on both
sides but for its shell; a body with a hole in its base is closed.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import igl
import numpy as np
from numpy.typing import NDArray

from mpf_core.cloud.denoise import denoise
from mpf_core.cloud.neighbors import analyse
from mpf_core.cloud.normalize import Similarity
from mpf_core.errors import MPFError
from mpf_core.experiments.shapes import SHAPES, distances, sample, shape
from mpf_core.fit.initialize import Initialization, initialize
from mpf_core.quality.metrics import compare
from mpf_core.quality.sampling import sample_surface
from mpf_core.quality.topology import topology
from mpf_core.surface.export import write_ply
from mpf_core.surface.isosurface import Grid, extract
from mpf_core.surface.mesh import Mesh
from mpf_core.surface.normals import face_normals

Floats = NDArray[np.float64]
CLOSED_ANYWAY = ("holed-body",)
PROBES = 5_000


@dataclass(frozen=True)
class Row:
    """A cloud: a shape, how many points, and what `sample` does to it."""

    shape: str
    points: int = 10_000
    noise: float = 0.0
    outliers: float = 0.0
    uneven: float = 1.0
    holes: int = 0
    thickness: float = 0.0

    @property
    def label(self) -> str:
        told = [self.shape]
        if self.points != 10_000:
            told.append(f"{self.points:,} points")
        plain = Row(self.shape)
        told += [
            f"{name} {getattr(self, name):g}"
            for name in ("noise", "outliers", "uneven", "holes", "thickness")
            if getattr(self, name) != getattr(plain, name)
        ]
        return ", ".join(told)

    def cloud(self) -> Floats:
        return sample(
            self.shape, self.points, 0,
            noise=self.noise, outliers=self.outliers, uneven=self.uneven, holes=self.holes,
            thickness=self.thickness,
        )  # fmt: skip


ROWS = (
    *(Row(name) for name in SHAPES),
    *(Row(name, thickness=t) for name in ("wave", "bowl", "sheet", "vase") for t in (0.02, 0.01)),
    *(Row(name, 50_000) for name in ("thin-bowl", "nested-shells", "room", "ship", "potted-plant")),
    *(Row(name, noise=0.005) for name in ("wave", "cube-sheet", "torus", "holed-body", "hat")),
    *(Row(name, holes=3) for name in ("sphere", "torus", "holed-body", "wave", "vase")),
    *(Row(name, uneven=8) for name in ("torus", "spike-ball", "wave", "plate-0.05", "plate-0.01")),
)


def is_inside(row: Row, x: Floats) -> NDArray[np.bool_]:
    """(n,) whether x (n, 3) is in the exact body."""
    spec, mesh = SHAPES[row.shape], shape(row.shape)
    if row.thickness > 0:
        return distances(row.shape, x) < row.thickness / 2
    if spec.kind == "sheet" and row.shape not in CLOSED_ANYWAY:
        return np.zeros(len(x), dtype=bool)
    faces = mesh.faces if row.shape in CLOSED_ANYWAY else _closed_part(mesh)
    # Bodies may overlap, and nested ones be turned inside out: any winding at all is inside.
    winding = igl.fast_winding_number(mesh.vertices, np.ascontiguousarray(faces), x)
    return np.asarray(winding > 0.5)


def _closed_part(mesh: Mesh) -> NDArray[np.int64]:
    _, component = igl.facet_components(mesh.faces)
    edges = np.sort(mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    _, inverse, count = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
    open_face = (count[inverse.ravel()].reshape(-1, 3) == 1).any(1)
    opened = np.zeros(component.max() + 1, dtype=bool)
    opened[component[open_face]] = True
    return np.asarray(mesh.faces[~opened[component]])


def probes(row: Row, shell: float) -> dict[str, tuple[Floats, NDArray[np.bool_]]]:
    """Points and the exact answer, by kind; none where a thin shell may rightly be."""
    rng, mesh = np.random.default_rng(1), shape(row.shape)
    drawn = sample_surface(mesh, PROBES, rng)
    normal = face_normals(mesh)[drawn.faces]
    across = rng.uniform(-0.1, 0.1, size=(PROBES, 1)) * normal
    thin = rng.uniform(-0.5, 0.5, size=(PROBES, 1)) * max(row.thickness, 0.006) * normal
    near = np.concatenate([drawn.points + across, drawn.points + thin])
    far = rng.uniform(-1.1, 1.1, size=(PROBES, 3))
    found = {}
    for kind, x in (("near", near), ("far", far)):
        wall = np.abs(distances(row.shape, x) - row.thickness / 2)
        inside = is_inside(row, x)
        least = 2 * shell + 0.003 if SHAPES[row.shape].kind != "solid" else 0.01
        if row.thickness:
            least = 0.01
        keep = np.where(inside, wall > 0.0015, wall > least) if kind == "near" else wall > 0.1
        found[kind] = x[keep], inside[keep]
    return found


def measure(row: Row, meshes: Path | None, with_mesh: bool) -> list[str]:
    """The cells of one row of the table."""
    raw = row.cloud()
    begin = time.perf_counter()
    frame = Similarity.of(raw)
    cleaned = denoise(frame.to_normalised(raw))
    neighbours = analyse(cleaned.thinned)
    start = initialize(neighbours)
    seconds = time.perf_counter() - begin
    cells = [row.label, f"{seconds:.1f}", f"{start.space.enclosures}", f"{100 * start.seeded:.0f}"]
    for kind, (x, inside) in probes(row, start.shell).items():
        wrong = (start.at(frame.to_normalised(x)).theta < 0) != inside
        kinds = (inside, ~inside) if kind == "near" else (inside | True,)
        cells += [f"{100 * wrong[k].mean():.2f}" if k.sum() > 20 else "–" for k in kinds]
    on = sample_surface(shape(row.shape), PROBES, np.random.default_rng(2)).points
    if not row.thickness:
        off = np.abs(start.at(frame.to_normalised(on)).theta).mean()
        cells.append(f"{1e3 * off:.2f}")
    else:
        cells.append("–")
    if not with_mesh:
        return [*cells, "–", "–", "–"]
    try:
        mesh = target_mesh(row, start, frame)
    except MPFError as error:
        return [*cells, type(error).__name__, "–", "–"]
    if meshes is not None:
        meshes.mkdir(parents=True, exist_ok=True)
        write_ply(mesh, meshes / f"{row.label.replace(', ', '-').replace(' ', '')}.ply")
    shown = topology(mesh)
    chamfer = compare(mesh, shape(row.shape), samples=50_000).chamfer
    closed = "yes" if shown.watertight else "no"
    return [*cells, f"{chamfer:.2f}", f"{shown.components}", closed]


def target_mesh(row: Row, start: Initialization, frame: Similarity) -> Mesh:
    """{θ* = 0} in the shape's frame, the grid fine enough for its thinnest wall."""
    points = start.local.neighbours.points
    thin = min(row.thickness or 1.0, float(row.shape[6:]) if row.shape[:5] == "plate" else 1.0)
    size = int(np.clip(2.6 / thin, 256, 560))
    grid = Grid.around(points.min(0) - 0.08, points.max(0) + 0.08, size)
    tree = start.local.neighbours.tree
    spacing = start.local.neighbours.median_spacing

    def theta(x: Floats) -> NDArray[np.float32]:
        parts = [start.at(x[i : i + 100_000]).theta for i in range(0, len(x), 100_000)]
        return np.concatenate(parts) if parts else np.empty(0, np.float32)

    found = extract(theta, grid, tree, reach=spacing)
    return Mesh(frame.to_input(found.vertices), found.faces)


def main() -> None:
    """Measures every row, prints the table as it goes."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--only", default="", help="rows whose label contains this, or this|that")
    parser.add_argument("--no-mesh", action="store_true")
    parser.add_argument("--meshes", type=Path)
    chosen = parser.parse_args()
    out = sys.stdout
    head = "cloud | s | enclosed | bounding % | wrong in % | wrong out % | wrong far % | off"
    out.write(f"| {head} | Chamfer | pieces | closed |\n| --- " + "| ---: " * 9 + "| --- |\n")
    for row in ROWS:
        if any(word in row.label for word in chosen.only.split("|")):
            out.write(f"| {' | '.join(measure(row, chosen.meshes, not chosen.no_mesh))} |\n")
            out.flush()


if __name__ == "__main__":
    main()
