"""From what a file held to what a fit can use; every step leaves a sentence in the report."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mpf_core.cloud.density import Density, measure_density
from mpf_core.cloud.errors import NoExtent
from mpf_core.cloud.limits import DEFAULT_LIMITS, MINIMUM_POINTS
from mpf_core.cloud.pointcloud import PointCloud
from mpf_core.errors import Collinear, NotFinite, TooLarge, TooSmall
from mpf_core.heeding import heed

_LARGEST_COORDINATE = 1e100  # beyond it squares overflow; no unit of length reaches there
_SMALLEST_SIDE = 1e-100
_LINE_TOLERANCE = 1e-6  # distance from the line, relative to its length
_OUTLIER_NEIGHBOURS = 16
_CHUNK = 65_536


@dataclass(frozen=True)
class PrepareOptions:
    """What preparation may change.

    max_not_finite: share of points with NaN or infinite coordinates that are dropped, which the
        report says; above it the cloud is refused
    outlier_sigma: points whose mean distance to 16 neighbours is more than so many standard
        deviations above the mean are removed; None keeps all
    max_points: more are refused
    measure: whether spacing, density and the normals' reliability go into the report
    """

    max_not_finite: float = 0.001
    outlier_sigma: float | None = None
    max_points: int = DEFAULT_LIMITS.max_points
    measure: bool = True


@dataclass(frozen=True)
class PreparationReport:
    """What preparation did, in numbers and in sentences (`steps`)."""

    received: int
    not_finite_dropped: int
    duplicates_merged: int
    outliers_removed: int
    kept: int
    density: Density | None
    steps: tuple[str, ...]


@dataclass(frozen=True)
class Prepared:
    """A cloud of at least 51 distinct, finite points that span a plane or more."""

    cloud: PointCloud
    report: PreparationReport


def prepare(cloud: PointCloud, options: PrepareOptions | None = None) -> Prepared:
    """The cloud without non-finite points, exact duplicates and (if asked) far outliers.

    Order and double precision are kept. Raises NotFinite, TooSmall, TooLarge, NoExtent or
    Collinear for what no surface can be made from.
    """
    options = options or PrepareOptions()
    received = len(cloud)
    if received > options.max_points:
        raise TooLarge(
            f"the cloud has {received} points, more than {options.max_points}",
            advice="Thin the cloud, or reconstruct it in parts.",
        )
    _refuse_small(received, "points")
    cloud, not_finite = _without_not_finite(cloud, options.max_not_finite)
    cloud, duplicates = _without_duplicates(cloud)
    heed()
    _refuse_small(len(cloud), "distinct points")
    _refuse_line(cloud.points)
    outliers = 0
    if options.outlier_sigma is not None:
        cloud, outliers = _without_outliers(cloud, options.outlier_sigma)
        _refuse_small(len(cloud), "distinct points without outliers")
        _refuse_line(cloud.points)
    steps = [f"{received} points received"]
    if not_finite:
        steps.append(f"{not_finite} points with NaN or infinite coordinates dropped")
    if duplicates:
        steps.append(f"{duplicates} exact duplicates merged")
    if outliers:
        steps.append(f"{outliers} outliers removed")
    steps.append(f"{len(cloud)} points kept")
    density = measure_density(cloud.points) if options.measure else None
    if density is not None:
        steps += density.sentences()
    report = PreparationReport(
        received, not_finite, duplicates, outliers, len(cloud), density, tuple(steps)
    )
    return Prepared(cloud, report)


def _refuse_small(count: int, what: str) -> None:
    if count < MINIMUM_POINTS:
        raise TooSmall(
            f"the cloud has {count} {what}",
            advice=f"A surface needs at least {MINIMUM_POINTS} distinct points.",
        )


def _select(cloud: PointCloud, keep: NDArray[np.bool_]) -> PointCloud:
    return PointCloud(
        points=cloud.points[keep],
        normals=None if cloud.normals is None else cloud.normals[keep],
        colors=None if cloud.colors is None else cloud.colors[keep],
        notes=cloud.notes,
    )


def _without_not_finite(cloud: PointCloud, most: float) -> tuple[PointCloud, int]:
    # NaN fails the comparison, so one test finds NaN, infinity and absurd size.
    good: NDArray[np.bool_] = np.all(np.abs(cloud.points) < _LARGEST_COORDINATE, axis=1)
    bad = len(good) - int(good.sum())
    if bad == 0:
        return cloud, 0
    if bad > most * len(good):
        first = int(np.argmin(good))
        values = ", ".join(f"{v:g}" for v in cloud.points[first])
        raise NotFinite(
            f"{bad} of {len(good)} points have NaN or infinite coordinates, "
            f"the first of them ({values})",
            where=f"point {first + 1}",
            advice="Remove them; only a few in a cloud are dropped without asking.",
        )
    return _select(cloud, good), bad


def _without_duplicates(cloud: PointCloud) -> tuple[PointCloud, int]:
    """Of points with equal coordinates the first stays, with its normal and colour."""
    keep = first_of_equal(cloud.points)
    merged = len(keep) - int(keep.sum())
    return (_select(cloud, keep), merged) if merged else (cloud, 0)


def first_of_equal(points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(n,) True where no earlier row of `points` (n, 3) is the same."""
    keys = _row_keys(points)
    order = np.argsort(keys, kind="stable")
    same_key = keys[order[1:]] == keys[order[:-1]]
    same_row = same_key.copy()
    rows = np.flatnonzero(same_key)
    same_row[rows] = (points[order[rows]] == points[order[rows + 1]]).all(axis=1)
    if not np.array_equal(same_row, same_key):  # two rows with one key: sort by the rows instead
        order = np.lexsort((np.arange(len(points)), points[:, 2], points[:, 1], points[:, 0]))
        same_row = (points[order[1:]] == points[order[:-1]]).all(axis=1)
    keep = np.ones(len(points), dtype=np.bool_)
    keep[order[1:][same_row]] = False
    return keep


def _row_keys(points: NDArray[np.float64]) -> NDArray[np.uint64]:
    """A 64-bit key of each row; equal rows have equal keys, and others hardly ever."""
    keys = np.zeros(len(points), dtype=np.uint64)
    for axis in range(points.shape[1]):
        column = points[:, axis] + 0.0  # -0 equals 0 and must not differ in its bits
        keys ^= column.view(np.uint64)
        keys *= np.uint64(0x9E3779B97F4A7C15)
        keys ^= keys >> np.uint64(29)
    return keys


def _refuse_line(points: NDArray[np.float64]) -> None:
    low, high = points.min(axis=0), points.max(axis=0)
    side = float((high - low).max())
    if side < _SMALLEST_SIDE:
        raise NoExtent(
            f"the longest side of the box is {side:g}",
            advice="Check the units: all points lie on top of each other.",
        )
    local = (points - low) / side
    local -= local.mean(axis=0)
    direction = np.linalg.eigh(local.T @ local)[1][:, -1]
    local -= np.outer(local @ direction, direction)
    distance = float(np.sqrt(np.einsum("nk,nk->n", local, local).max()))
    # Coordinates far from the origin are rounded; a line that was rounded is still a line.
    rounding = 4 * np.finfo(np.float64).eps * float(np.abs([low, high]).max()) / side
    if distance <= _LINE_TOLERANCE + rounding:
        raise Collinear(
            "all points lie on one line",
            advice="Check that the file's columns are x, y and z.",
        )


def _without_outliers(cloud: PointCloud, sigma: float) -> tuple[PointCloud, int]:
    """Statistical outlier removal by the mean distance to the 16 nearest neighbours."""
    low = cloud.points.min(axis=0)
    local = cloud.points - low
    tree = cKDTree(local)
    mean = np.empty(len(local))
    for start in range(0, len(local), _CHUNK):
        part = slice(start, start + _CHUNK)
        found = tree.query(local[part], _OUTLIER_NEIGHBOURS + 1)
        mean[part] = np.asarray(found[0])[:, 1:].mean(axis=1)
    keep = mean <= mean.mean() + sigma * mean.std()
    removed = len(keep) - int(keep.sum())
    return (_select(cloud, keep), removed) if removed else (cloud, 0)
