"""Clouds for a first try: simulated range scans of thin things, and one real measurement."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mpf_core.cloud.pointcloud import PointCloud
from mpf_core.errors import OptionsError
from mpf_core.experiments.scanning import Viewpoint, ring, scan
from mpf_core.experiments.shapes import shape
from mpf_core.surface.mesh import Mesh

DEFAULT = "potted-plant"
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Sample:
    """A cloud that can be made.

    points: how many by default; unit: of its coordinates; truth: the exact surface in the cloud's
    frame, for simulated scans
    """

    name: str
    about: str
    points: int
    unit: str
    make: Callable[[int, int], PointCloud]
    truth: Callable[[], Mesh] | None


@dataclass(frozen=True)
class _Scan:
    """A shape of a real size, on a table somewhere, and the scanners around it."""

    shape: str
    size: float
    place: tuple[float, float, float]
    noise: float
    viewpoints: tuple[Viewpoint, ...]

    def cloud(self, count: int, seed: int) -> PointCloud:
        measured = scan(
            shape(self.shape), self.viewpoints, count,
            noise=self.noise / (self.size / 2), seed=seed,
        )  # fmt: skip
        return PointCloud(self._placed(measured.points), colors=measured.colors)

    def truth(self) -> Mesh:
        exact = shape(self.shape)
        return Mesh(self._placed(exact.vertices), exact.faces, None, exact.colors)

    def _placed(self, points: Floats) -> Floats:
        return np.asarray(points * (self.size / 2) + np.array(self.place))


def jacksboro(count: int, seed: int) -> PointCloud:
    """The radar elevation model of the Jacksboro fault, in metres east, north and up.

    Shuttle radar (SRTM, 3 arc seconds, public domain) as matplotlib's sample data carry it; the
    origin is the middle of the tile at sea level. All 138 632 points, or a random part of them.
    """
    from matplotlib.cbook import get_sample_data

    path = get_sample_data("jacksboro_fault_dem.npz", asfileobj=False)
    with np.load(str(path)) as model:
        height = model["elevation"].astype(np.float64)
        step = float(model["dx"]), float(model["dy"])
        # The file's "ymin" is the northern edge: its rows run southwards.
        latitude = (float(model["ymin"]) + float(model["ymax"])) / 2
    rows, columns = height.shape
    east, north = _metres_per_degree(latitude)
    x = (np.arange(columns) - (columns - 1) / 2) * step[0] * east
    y = ((rows - 1) / 2 - np.arange(rows)) * step[1] * north
    grid_x, grid_y = np.meshgrid(x, y)
    points = np.stack([grid_x, grid_y, height], axis=2).reshape(-1, 3)
    if count < len(points):
        points = points[np.random.default_rng(seed).permutation(len(points))[:count]]
    return PointCloud(points)


def _metres_per_degree(latitude: float) -> tuple[float, float]:
    """Length of a degree of longitude and of latitude on the WGS 84 ellipsoid."""
    equator, flattening = 6_378_137.0, 1 / 298.257223563
    squared = flattening * (2 - flattening)
    sine = np.sin(np.radians(latitude))
    across = equator / np.sqrt(1 - squared * sine**2)
    along = equator * (1 - squared) / (1 - squared * sine**2) ** 1.5
    degree = np.pi / 180
    return float(degree * across * np.cos(np.radians(latitude))), float(degree * along)


def _scanned(name: str, about: str, points: int, setup: _Scan) -> Sample:
    return Sample(name, about, points, "m", setup.cloud, setup.truth)


_ALL = (
    _scanned(
        "potted-plant",
        "a clay pot with leaves of one layer, scanned all around, in colour",
        60_000,
        _Scan("potted-plant", 0.62, (1.25, 0.40, 1.06), 0.0004,
              ring(6, 22) + ring(4, 52, start=30) + ring(4, -30, start=15)),
    ),
    _scanned(
        "sailing-ship",
        "a model ship: solid hull, thin masts, sails of one layer, in colour",
        60_000,
        _Scan("ship", 0.90, (0.0, 2.0, 1.4), 0.0004,
              ring(8, 12) + ring(4, 45, start=45)),
    ),
    _scanned(
        "maple-leaf",
        "one leaf, seen from above only",
        20_000,
        _Scan("maple-leaf", 0.14, (0.0, 0.0, 0.0), 0.0001, ring(3, 62)),
    ),
    _scanned(
        "flower",
        "three whorls of overlapping petals, seen from above",
        40_000,
        _Scan("flower", 0.11, (0.0, 0.0, 0.05), 0.00005, ring(6, 40) + ring(3, 70, start=20)),
    ),
    _scanned(
        "dress",
        "a dress of one layer in deep folds, open above and below",
        40_000,
        _Scan("dress", 1.30, (0.0, 0.0, 0.7), 0.001, ring(8, 8) + ring(3, 50, start=20)),
    ),
    _scanned(
        "statuette",
        "a body that stood on its base: nothing was measured there",
        30_000,
        _Scan("holed-body", 0.30, (0.0, 0.0, 0.15), 0.0002, ring(6, 20) + ring(2, 60)),
    ),
    _scanned(
        "room",
        "a corner of a room with a table, chairs, a shelf, a lamp and a curtain",
        60_000,
        _Scan("room", 5.0, (0.0, 0.0, 1.75), 0.003,
              (Viewpoint((0.75, -0.85, 0.1), (-0.3, 0.3, -0.3), 110),
               Viewpoint((0.85, 0.2, 0.2), (-0.5, 0.0, -0.4), 110),
               Viewpoint((-0.5, -0.9, 0.3), (0.2, 0.5, -0.5), 110),
               Viewpoint((0.2, -0.1, 0.5), (-0.2, 0.6, -0.5), 110))),
    ),
    Sample(
        "jacksboro-fault",
        "real: a radar elevation model of a fault in Tennessee, an open sheet",
        138_632,
        "m",
        jacksboro,
        None,
    ),
)  # fmt: skip
SAMPLES: dict[str, Sample] = {sample.name: sample for sample in _ALL}


def make_sample(name: str = DEFAULT, points: int | None = None, seed: int = 0) -> PointCloud:
    """The cloud of a sample of SAMPLES, in its unit."""
    if name not in SAMPLES:
        raise OptionsError(
            f"there is no sample {name!r}", advice=f"Use one of {', '.join(SAMPLES)}."
        )
    return SAMPLES[name].make(points or SAMPLES[name].points, seed)
