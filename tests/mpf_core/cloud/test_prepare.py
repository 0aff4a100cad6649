"""Preparation: what is dropped, merged, refused, and that the report says so."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from mpf_core.cloud.density import measure_density
from mpf_core.cloud.pointcloud import PointCloud
from mpf_core.cloud.prepare import PrepareOptions, first_of_equal, prepare
from mpf_core.errors import CloudError

UTM = np.array([448_262.123, 5_411_932.456, 312.789])


def noise(n: int, seed: int = 0) -> NDArray[np.float64]:
    return np.random.default_rng(seed).normal(size=(n, 3))


def grid(side: int) -> NDArray[np.float64]:
    x, y = np.meshgrid(np.arange(side), np.arange(side))
    return np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1).astype(np.float64)


def refused(points: NDArray[np.float64], options: PrepareOptions | None = None) -> CloudError:
    with pytest.raises(CloudError) as caught:
        prepare(PointCloud(points), options)
    assert caught.value.advice
    return caught.value


def test_a_sound_cloud_is_kept_as_it_is() -> None:
    cloud = PointCloud(noise(100) + UTM)
    prepared = prepare(cloud)
    np.testing.assert_array_equal(prepared.cloud.points, cloud.points)
    assert prepared.report.kept == prepared.report.received == 100


def test_duplicates_are_merged_with_what_they_carry() -> None:
    points = noise(60)
    colors = np.arange(180, dtype=np.uint8).reshape(60, 3)
    cloud = PointCloud(
        np.concatenate([points, points[::-1]]),
        np.concatenate([points, -points]),
        np.concatenate([colors, colors]),
    )
    prepared = prepare(cloud)
    np.testing.assert_array_equal(prepared.cloud.points, points)
    np.testing.assert_array_equal(prepared.cloud.normals, points)
    np.testing.assert_array_equal(prepared.cloud.colors, colors)
    assert prepared.report.duplicates_merged == 60
    assert "60 exact duplicates merged" in prepared.report.steps


@settings(max_examples=100, deadline=None)
@given(arrays(np.float64, st.tuples(st.integers(1, 30), st.just(3)), elements=st.sampled_from(
    [0.0, -0.0, 1.0, 2.0**-1074, 1e300, -1.0]
)))  # fmt: skip
def test_first_of_equal(points: NDArray[np.float64]) -> None:
    seen: set[tuple[float, ...]] = set()
    expected = []
    for row in points.tolist():
        expected.append(tuple(row) not in seen)
        seen.add(tuple(row))
    assert first_of_equal(points).tolist() == expected


def test_rows_with_one_key_are_told_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "mpf_core.cloud.prepare._row_keys", lambda p: np.zeros(len(p), dtype=np.uint64)
    )
    assert first_of_equal(np.array([[1.0, 2, 3], [1, 2, 4], [1, 2, 3]])).tolist() == [
        True,
        True,
        False,
    ]


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e200])
def test_few_points_that_are_not_finite_are_dropped_and_many_refused(bad: float) -> None:
    points = noise(2000)
    points[[7, 9], 1] = bad
    report = prepare(PointCloud(points)).report
    assert (report.not_finite_dropped, report.kept) == (2, 1998)
    points[20, 2] = bad
    error = refused(points)
    assert (error.code, error.where) == ("cloud.not_finite", "point 8")
    assert prepare(PointCloud(points), PrepareOptions(max_not_finite=0.01)).report.kept == 1997


@pytest.mark.parametrize(
    ("points", "code"),
    [
        (noise(0), "cloud.too_small"),
        (noise(50), "cloud.too_small"),
        (np.tile(noise(50), (9, 1)), "cloud.too_small"),
        (np.outer(np.arange(99), [1.0, 2, 3]), "cloud.collinear"),
        (np.outer(np.linspace(0, 1, 99), [1e-6, 2e-6, 0]) + UTM, "cloud.collinear"),
        (np.outer(np.arange(99), [1e90, 0, 0]), "cloud.collinear"),
        (noise(99) * 1e-200, "cloud.no_extent"),
        (np.full((99, 3), np.nan), "cloud.not_finite"),
    ],
)
def test_what_makes_no_surface_is_refused(points: NDArray[np.float64], code: str) -> None:
    assert refused(points).code == code


def test_fifty_one_points_of_a_plane_are_enough() -> None:
    for scale in (1e-6, 1.0, 1e6):
        points = noise(51) * [1, 1e-3, 0] * scale
        assert prepare(PointCloud(points)).report.kept == 51


def test_too_many_points_are_refused() -> None:
    assert refused(noise(99), PrepareOptions(max_points=98)).code == "cloud.too_large"


def test_outliers_go_on_request() -> None:
    points = np.concatenate([grid(40), [[20, 20, 500.0], [-300, 0, 0]]]) + UTM
    assert prepare(PointCloud(points)).report.outliers_removed == 0
    prepared = prepare(PointCloud(points), PrepareOptions(outlier_sigma=4))
    assert prepared.report.outliers_removed == 2
    np.testing.assert_array_equal(prepared.cloud.points, points[:-2])


def test_every_step_has_its_sentence() -> None:
    points = np.concatenate([grid(50), grid(50)[:7], [[20, 20, 500.0], [np.nan, 0, 0]]])
    report = prepare(PointCloud(points), PrepareOptions(outlier_sigma=4)).report
    assert report.steps[:5] == (
        "2509 points received",
        "1 points with NaN or infinite coordinates dropped",
        "7 exact duplicates merged",
        "1 outliers removed",
        "2500 points kept",
    )
    assert len(report.steps) > 5  # spacing, density and the normals' reliability


def test_density_of_a_sheet_and_of_noise() -> None:
    sheet = measure_density(grid(60) * 0.25 + UTM)
    assert sheet.spacing == pytest.approx(0.25, rel=1e-6)
    assert sheet.normal_reliability == 1
    assert measure_density(noise(4000)).normal_reliability < 0.7
    report = prepare(PointCloud(grid(20))).report
    assert report.density is not None
    assert any("spacing 1 " in step for step in report.steps)
    assert prepare(PointCloud(grid(20)), PrepareOptions(measure=False)).report.density is None
