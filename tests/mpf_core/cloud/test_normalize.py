"""The normalised frame and back."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mpf_core.cloud.normalize import Similarity
from mpf_core.errors import CloudError


@settings(max_examples=100, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.floats(-6, 6).map(lambda e: 10**e),
    st.floats(-1e3, 1e3),
)
def test_box_fits_and_points_come_back(seed: int, size: float, away: float) -> None:
    rng = np.random.default_rng(seed)
    points = (rng.uniform(-1, 1, (60, 3)) * [1, 0.5, 0.1] + away) * size
    frame = Similarity.of(points)
    inside = frame.to_normalised(points)
    low, high = inside.min(axis=0), inside.max(axis=0)
    assert (high - low).max() == pytest.approx(2, rel=1e-9)
    np.testing.assert_allclose(low + high, 0, atol=1e-9)
    np.testing.assert_allclose(
        frame.to_input(inside), points, rtol=0, atol=4e-16 * (1 + abs(away)) * size * 4
    )
    assert frame.length_to_input(frame.length_to_normalised(size)) == pytest.approx(size)


def test_utm_keeps_its_millimetres() -> None:
    rng = np.random.default_rng(0)
    corner = np.array([448_262, 5_411_932, 312])
    points = np.round(corner + rng.uniform(0, 300, (5000, 3)), 3)
    frame = Similarity.of(points)
    back = frame.to_input(frame.to_normalised(points))
    np.testing.assert_array_equal(np.round(back, 3), points)
    assert np.abs(back - points).max() < 1e-8
    # Single precision would not do: its steps at a UTM northing are half a metre.
    assert np.abs(points.astype(np.float32) - points).max() > 0.1


def test_single_precision_input_is_shifted_in_double() -> None:
    points = np.array([[1e6, 0, 0], [1e6 + 1, 1, 1]], dtype=np.float32)
    frame = Similarity.of(points.astype(np.float64))
    assert frame.to_normalised(points).dtype == np.float64
    np.testing.assert_array_equal(frame.to_normalised(points), [[-1, -1, -1], [1, 1, 1]])


@pytest.mark.parametrize(
    ("points", "code"),
    [
        (np.zeros((0, 3)), "cloud.too_small"),
        (np.ones((9, 3)), "cloud.no_extent"),
        (np.array([[0, 0, 0], [np.nan, 0, 0.0]]), "cloud.not_finite"),
        (np.array([[-1e308, 0, 0], [1e308, 0, 0]]), "cloud.not_finite"),
    ],
)
def test_no_frame(points: np.ndarray, code: str) -> None:
    with pytest.raises(CloudError) as caught:
        Similarity.of(points)
    assert caught.value.code == code
