"""One run of an experiment: which shape, which cloud, which method, and what came of it.

A trial that was run leaves one JSON file, its row. Running an experiment again takes the rows that
are there, so that a long one can be stopped and resumed.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import os
import platform
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mpf_core.cloud.limits import DEFAULT_LIMITS, HEADER_BYTES
from mpf_core.cloud.neighbors import median_spacing
from mpf_core.cloud.normalize import Similarity
from mpf_core.cloud.plyheader import parse_header
from mpf_core.cloud.pointcloud import PointCloud
from mpf_core.cloud.reader import read_cloud
from mpf_core.errors import MPFError
from mpf_core.experiments.shapes import sample, whole
from mpf_core.files import write_atomically
from mpf_core.quality.metrics import compare, evaluate, farthest_component, points_to_surface
from mpf_core.quality.topology import topology
from mpf_core.surface.export import cloud_ply_bytes, write_glb, write_ply
from mpf_core.surface.intersections import self_intersections
from mpf_core.surface.mesh import Mesh

Row = dict[str, Any]
FITS = ("mpf", "course", "process")  # methods that are reconstructions: whole, watched, apart
SCANS = (".xyz", ".txt", ".pts", ".ply")
_LIBRARIES = ("numpy", "scipy", "torch", "libigl")


@dataclass(frozen=True)
class Trial:
    """A shape, the cloud sampled from it (see `shapes.sample`), and the method that meets it.

    label: the row's name in the table; shape: a name, a mesh file, or the file of a scan, of which
    there is no exact surface and `points` are drawn; options: what `options_from` reads, as sorted
    pairs
    """

    label: str
    shape: str
    points: int = 10_000
    seed: int = 0
    noise: float = 0.0
    outliers: float = 0.0
    uneven: float = 1.0
    holes: int = 0
    thickness: float = 0.0
    method: str = "mpf"
    options: tuple[tuple[str, Any], ...] = ()

    @property
    def key(self) -> str:
        """A file name of its own: readable, and different whenever any setting is."""
        settings = json.dumps(asdict(self), sort_keys=True).encode()
        digest = hashlib.sha256(settings).hexdigest()[:10]
        return f"{Path(self.shape).stem}-{self.method}-{self.seed}-{digest}"

    @property
    def is_fit(self) -> bool:
        """Whether `options` are those of a reconstruction."""
        return self.method in FITS

    @property
    def is_scan(self) -> bool:
        """Whether the cloud is measured, so that no exact surface is known."""
        path = Path(self.shape)
        kind = path.suffix.lower()
        return kind in SCANS and not (kind == ".ply" and _has_triangles(path))

    def cloud(self) -> NDArray[np.float64]:
        """(n, 3) points in the shape's normalised frame."""
        if self.is_scan:
            points = read_cloud(Path(self.shape)).points
            drawn = np.random.default_rng(self.seed).permutation(len(points))[: self.points]
            return Similarity.of(points).to_normalised(points[drawn])
        return sample(
            self.shape, self.points, self.seed, noise=self.noise, outliers=self.outliers,
            uneven=self.uneven, holes=self.holes, thickness=self.thickness,
        )  # fmt: skip

    def seeded(self, seeds: int) -> tuple[Trial, ...]:
        """This trial with each of `seeds` seeds."""
        return tuple(replace(self, seed=k) for k in range(seeds))


@dataclass(frozen=True)
class Moment:
    """A fit under way: the mesh of its field, None while there is none, after so many iterations
    and seconds since the beginning."""

    iteration: int
    seconds: float
    mesh: Mesh | None


@dataclass(frozen=True)
class Outcome:
    """What a method made of a cloud: a mesh in the cloud's frame, and what it tells of itself.

    alone: the mesh before the last step, where there was one; seconds: from reading the cloud's
    file to the written mesh; figures: to stand among the metrics; course: the way to the mesh
    """

    mesh: Mesh
    facts: Mapping[str, Any] = field(default_factory=dict)
    alone: Mesh | None = None
    seconds: float | None = None
    figures: Mapping[str, float] = field(default_factory=dict)
    course: Sequence[Moment] = ()


Method = Callable[[NDArray[np.float64], Trial], Outcome]


def run(
    trials: Sequence[Trial],
    directory: str | Path,
    methods: Mapping[str, Method],
    *,
    samples: int = 100_000,
) -> Iterator[Row]:
    """The row of each trial, from its file if it was run before, in the order given.

    Writes `rows/{key}.json` and `meshes/{key}.ply`. A method's failure is a row with `error`, and
    is tried again the next time.
    """
    directory = Path(directory)
    for folder in ("rows", "meshes"):
        (directory / folder).mkdir(parents=True, exist_ok=True)
    for trial in trials:
        path = directory / "rows" / f"{trial.key}.json"
        row = json.loads(path.read_text()) if path.is_file() else None
        if row is None or "error" in row:
            row = _executed(trial, directory, methods[trial.method], samples)
            write_atomically(path, json.dumps(row, indent=2).encode())
        yield row


def mesh_path(directory: str | Path, row: Row, iteration: int | None = None) -> Path:
    """Where `run` left the mesh of a row, or that of a moment of its course."""
    moment = "" if iteration is None else f"-{iteration}"
    return Path(directory) / "meshes" / f"{row['key']}{moment}.ply"


def mpf(points: NDArray[np.float64], trial: Trial) -> Outcome:
    """Metric-Phase Fields, with the trial's options, from a file to a file as for a user."""
    import torch

    from mpf_core.options import options_from
    from mpf_core.parallel import workers
    from mpf_core.pipeline import reconstruct
    from mpf_core.surface.extraction import extract_mesh

    options = options_from({"seed": trial.seed, **dict(trial.options)})
    with TemporaryDirectory() as folder:
        cloud = Path(folder) / "cloud.ply"
        cloud.write_bytes(cloud_ply_bytes(PointCloud(points), []))
        begin = time.perf_counter()
        result = reconstruct(read_cloud(cloud).points, options)
        write_glb(result.mesh, Path(folder) / "mesh.glb")
        seconds = time.perf_counter() - begin
    told = ("timings", "extraction", "input", "fit", "surface")
    facts = {name: result.report[name] for name in told}
    with workers(options.threads or torch.get_num_threads()):
        alone = extract_mesh(result.fitted, options.surface).mesh
    return Outcome(result.mesh, facts, alone, seconds)


METHODS: dict[str, Method] = {"mpf": mpf}


def machine() -> dict[str, str]:
    """What a row was measured on."""
    found = {"python": platform.python_version(), "system": platform.platform(terse=True)}
    found["cpus"] = str(os.cpu_count())
    for name in _LIBRARIES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


def _has_triangles(path: Path) -> bool:
    """Whether the header of a PLY file names faces."""
    with path.open("rb") as file:
        header = parse_header(file.read(HEADER_BYTES), path.stat().st_size, DEFAULT_LIMITS)
    return header is not None and any(e.name == "face" and e.count for e in header.elements)


def _executed(trial: Trial, directory: Path, method: Method, samples: int) -> Row:
    settings = asdict(trial) | {"options": dict(trial.options)}
    row: Row = {"key": trial.key, "trial": settings, "machine": machine()}
    points = trial.cloud()
    start = time.perf_counter()
    try:
        outcome = method(points, trial)
    except MPFError as error:
        return row | {"error": str(error), "seconds": time.perf_counter() - start}
    row["seconds"] = outcome.seconds or time.perf_counter() - start
    row["metrics"] = _measured(outcome.mesh, points, trial, samples)
    if outcome.alone is not None:
        alone = _measured(outcome.alone, points, trial, samples)
        row["metrics"] |= {f"alone_{name}": value for name, value in alone.items()}
    row["metrics"] |= outcome.figures
    if outcome.course:
        row["course"] = [_moment(m, directory, row, trial, samples) for m in outcome.course]
    row["facts"] = dict(outcome.facts)
    write_ply(outcome.mesh, mesh_path(directory, row))
    return row


def _moment(
    moment: Moment, directory: Path, row: Row, trial: Trial, samples: int
) -> dict[str, Any]:
    found: dict[str, Any] = {"iteration": moment.iteration, "seconds": moment.seconds}
    if moment.mesh is None:
        return found
    write_ply(moment.mesh, mesh_path(directory, row, moment.iteration))
    # Crossings are left out: early on there are more floaters than they can be counted on.
    measured = compare(moment.mesh, whole(trial.shape, trial.thickness), samples=samples)
    return found | asdict(measured) | {"components": topology(moment.mesh).components}


def _measured(
    mesh: Mesh, points: NDArray[np.float64], trial: Trial, samples: int
) -> dict[str, Any]:
    tree = cKDTree(points)
    found: dict[str, Any] = {
        "input_to_surface": 1e3 * points_to_surface(points, mesh).mean,
        "farthest_component": farthest_component(mesh, tree) / median_spacing(tree),
    }
    if trial.is_scan:
        crossings = len(self_intersections(mesh))
        return found | asdict(topology(mesh)) | {"self_intersections": crossings}
    return found | evaluate(mesh, whole(trial.shape, trial.thickness), samples=samples).as_dict()
