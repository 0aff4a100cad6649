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
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpf_core.errors import MPFError
from mpf_core.experiments.shapes import sample, shape
from mpf_core.files import write_atomically
from mpf_core.quality.metrics import evaluate
from mpf_core.surface.export import write_ply
from mpf_core.surface.mesh import Mesh

Row = dict[str, Any]
_LIBRARIES = ("numpy", "scipy", "torch", "libigl")


@dataclass(frozen=True)
class Trial:
    """A shape, the cloud sampled from it (see `shapes.sample`), and the method that meets it.

    label: the row's name in the table; options: what `options_from` reads, as sorted pairs
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
        return f"{self.shape}-{self.method}-{self.seed}-{digest}"

    def cloud(self) -> NDArray[np.float64]:
        """(n, 3) points in the shape's normalised frame."""
        return sample(
            self.shape, self.points, self.seed, noise=self.noise, outliers=self.outliers,
            uneven=self.uneven, holes=self.holes, thickness=self.thickness,
        )  # fmt: skip

    def seeded(self, seeds: int) -> tuple[Trial, ...]:
        """This trial with each of `seeds` seeds."""
        return tuple(replace(self, seed=k) for k in range(seeds))


@dataclass(frozen=True)
class Outcome:
    """What a method made of a cloud: a mesh in the cloud's frame, and what it tells of itself."""

    mesh: Mesh
    facts: Mapping[str, Any] = field(default_factory=dict)


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


def mesh_path(directory: str | Path, row: Row) -> Path:
    """Where `run` left the mesh of a row."""
    return Path(directory) / "meshes" / f"{row['key']}.ply"


def mpf(points: NDArray[np.float64], trial: Trial) -> Outcome:
    """Metric-Phase Fields, with the trial's options."""
    from mpf_core.options import options_from
    from mpf_core.pipeline import reconstruct

    options = options_from({"seed": trial.seed, **dict(trial.options)})
    result = reconstruct(points, options)
    told = ("timings", "extraction", "input")
    return Outcome(result.mesh, {name: result.report[name] for name in told})


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


def _executed(trial: Trial, directory: Path, method: Method, samples: int) -> Row:
    settings = asdict(trial) | {"options": dict(trial.options)}
    row: Row = {"key": trial.key, "trial": settings, "machine": machine()}
    points = trial.cloud()
    start = time.perf_counter()
    try:
        outcome = method(points, trial)
    except MPFError as error:
        return row | {"error": str(error), "seconds": time.perf_counter() - start}
    row["seconds"] = time.perf_counter() - start
    row["metrics"] = evaluate(outcome.mesh, shape(trial.shape), samples=samples).as_dict()
    row["facts"] = dict(outcome.facts)
    write_ply(outcome.mesh, mesh_path(directory, row))
    return row
