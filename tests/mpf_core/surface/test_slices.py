"""Slice pictures, read back pixel by pixel."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from mpf_core.surface.drawing import number, round_length
from mpf_core.surface.sliceimage import STACK, Format, slice_image
from mpf_core.surface.slices import _refined, cut, write_slices

CENTER = np.array([448_262.0, 5_411_932.0, 312.0])


@dataclass(frozen=True)
class Frame:
    """A frame as `Similarity` gives it."""

    scale: float = 0.04

    def to_input(self, points: NDArray[np.floating]) -> NDArray[np.float64]:
        return np.asarray(points) / self.scale + CENTER


def ball(points: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.linalg.norm(points, axis=1) - 0.5


def pixels(png: bytes) -> NDArray[np.int64]:
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(np.int64)


def plane(h: int = 101, w: int = 101) -> NDArray[np.float64]:
    """v = x, from -1 to 1, the same in every row."""
    return np.tile(np.linspace(-1, 1, w), (h, 1))


def test_zero_level_is_a_dark_line_between_two_colours() -> None:
    image = pixels(slice_image(plane(), (-1, 1, -1, 1), axis="z", at=0.0))
    row = image[400]
    middle = 18 + 400
    assert row[middle].max() < 60
    red, blue = row[:, 0], row[:, 2]
    assert (blue > red)[100:400].all()
    assert (red > blue)[440:800].all()


def test_upwards_is_up() -> None:
    image = pixels(slice_image(plane().T, (-1, 1, -1, 1), axis="z", at=0.0))
    above, below = image[100, 400], image[700, 400]
    assert above[0] > above[2]
    assert below[2] > below[0]


def test_shape_follows_the_extent() -> None:
    wide = pixels(slice_image(plane(21, 81), (0, 8, 0, 2), axis="y", at=1.0))
    square = pixels(slice_image(plane(), (0, 8, 0, 8), axis="y", at=1.0))
    assert wide.shape[1] == square.shape[1]
    assert square.shape[0] - wide.shape[0] == 600


def test_scale_bar_has_a_round_length() -> None:
    # 800 pixels show 60 units; the bar is the greatest of 1, 2, 5 … within 240 pixels: 10 units.
    image = pixels(slice_image(plane(), (0, 60, 0, 60), axis="y", at=1.0))
    strip = image[18 + 800 + 22, 400:]
    assert (strip.max(axis=1) < 60).sum() == pytest.approx(10 * 800 / 60, abs=2)


def test_a_field_without_a_sign_change_is_drawn_too() -> None:
    for values in (np.zeros((4, 4)), np.ones((4, 4)), np.abs(plane())):
        pixels(slice_image(values, (0, 1, 0, 1), axis="x", at=0.0, field="r"))


def test_files_and_positions(tmp_path: Path) -> None:
    box = np.array([[-1.0, -0.8, -0.6], [1.0, 0.8, 0.6]])
    written = write_slices(
        ball, Frame(), box, 2, tmp_path, format=Format(samples=64), unit_label="m"
    )
    names = {str(s.path.relative_to(tmp_path)) for s in written}
    assert all(s.path.parent.name == s.cut.axis for s in written)
    assert names == {f"slices/{a}/{k}.png" for a in "xyz" for k in (0, 1)}
    at = {(s.cut.axis, s.index): s.cut.at for s in written}
    assert at["x", 0] == pytest.approx(CENTER[0] - 12.5)
    assert at["z", 1] == pytest.approx(CENTER[2] + 7.5)
    assert all(Image.open(s.path).format == "PNG" for s in written)


def test_cut_asks_for_the_plane_only() -> None:
    asked: list[NDArray[np.float64]] = []

    def remember(points: NDArray[np.float64]) -> NDArray[np.float64]:
        asked.append(points)
        return ball(points)

    box = np.array([[-1.0, -1, -0.5], [1.0, 1, 0.5]])
    at = cut(remember, Frame(), box, "y", 0.25, format=Format(samples=65)).at
    points = np.concatenate(asked)
    assert len(np.unique(points, axis=0)) == len(points) < 65 * 33
    assert (points[:, 1] == 0.25).all()
    assert points[:, [0, 2]].min(axis=0).tolist() == [-1, -0.5]
    assert at == pytest.approx(CENTER[1] + 0.25 / 0.04)


@pytest.mark.parametrize("format", [STACK, Format(samples=65)])
def test_a_cut_says_where_its_plot_lies(format: Format) -> None:
    box = np.array([[-1.0, -1, -0.5], [1.0, 1, 0.5]])
    made = cut(ball, Frame(), box, "y", 0.0, format=format)
    corners = Frame().to_input(box)
    assert made.extent == pytest.approx((*corners[:, 0], *corners[:, 2]))
    left, top, width, height = made.plot
    image = pixels(made.picture)
    # The frame is drawn around the plot, and the middle of the ball is the middle of the plot.
    around = image[top - 1 : top + height + 1, left - 1 : left + width + 1]
    assert (around[0] == around[0, 0]).all() and (around[:, -1] == around[0, 0]).all()
    assert width / height == pytest.approx(2.0, abs=0.02)
    inside = image[top : top + height, left : left + width].astype(int)
    # Blue within, red beyond: symmetric about the middle.
    blue = inside[..., 2] > inside[..., 0] + 20
    rows, columns = np.nonzero(blue)
    assert rows.mean() == pytest.approx((height - 1) / 2, abs=1.0)
    assert columns.mean() == pytest.approx((width - 1) / 2, abs=1.0)


def test_only_the_neighbourhood_of_the_zero_level_is_sampled_finely() -> None:
    x, y = np.meshgrid(np.linspace(-1, 1, 201), np.linspace(-1, 1, 201))
    points = np.stack([x, y, np.zeros_like(x)], axis=2)
    values = _refined(ball, points, below=[0.08, 0.04])
    exact = ball(points.reshape(-1, 3)).reshape(x.shape)
    near = np.abs(exact) < 0.035
    assert np.array_equal(values[near], exact[near])
    # Elsewhere within the curvature of a cell; the tip of the cone at the centre is the worst.
    assert np.abs(values - exact).max() < 0.01


def test_pictures_of_a_stack_are_small() -> None:
    image = pixels(slice_image(plane(), (-1, 1, -1, 1), axis="z", at=0.0, format=STACK))
    assert 320 < image.shape[0] < image.shape[1] < 450
    # The scale of colours is there too, and the dark line.
    assert image[11 + 160, 11 + 160].max() < 60
    assert (image[11 + 40, 11 + 320 + 14 : 11 + 320 + 25] < 250).any()


def test_round_lengths_and_numbers() -> None:
    lengths = [round_length(v) for v in (0.0099, 0.01, 3.0, 4.9999, 5, 12, 700)]
    assert lengths == pytest.approx([0.005, 0.01, 2, 2, 5, 10, 500])
    assert number(-0.25, 0.05) == "−0.25"
    assert number(-0.0001, 0.1) == "0.0"
    assert number(448262.125, 0.5) == "448262.1"
