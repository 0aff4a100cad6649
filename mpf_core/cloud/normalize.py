"""The normalised frame: the cloud's box, centred, with its longest side from -1 to 1."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mpf_core.cloud.errors import NoExtent
from mpf_core.errors import NotFinite, TooSmall

_SMALLEST_SIDE = 1e-100
_LARGEST_COORDINATE = 1e100


@dataclass(frozen=True)
class Similarity:
    """Shift and uniform scale from the input's frame to [-1, 1]³ and back, in double precision.

    center: (3,) float64, centre of the box, input units
    scale: normalised units per input unit
    """

    center: NDArray[np.float64]
    scale: float

    @classmethod
    def of(cls, points: NDArray[np.float64]) -> Similarity:
        """The frame of `points` (n, 3): box centre to the origin, longest side to 2."""
        if len(points) == 0:
            raise TooSmall("there are no points", advice="Give a cloud with points in it.")
        low = points.min(axis=0).astype(np.float64)
        high = points.max(axis=0).astype(np.float64)
        if (
            not (np.abs(low) < _LARGEST_COORDINATE).all()
            or not (np.abs(high) < _LARGEST_COORDINATE).all()
        ):
            raise NotFinite(
                "the box of the points is not finite", advice="Prepare the cloud first."
            )
        side = float((high - low).max())
        if side < _SMALLEST_SIDE:
            raise NoExtent(
                f"the longest side of the box is {side:g}",
                advice="Check the units: all points lie on top of each other.",
            )
        # low + half the side, not the mean of the corners: exact where the corners are.
        return cls(center=low + (high - low) / 2, scale=2.0 / side)

    def to_normalised(self, points: NDArray[np.floating]) -> NDArray[np.float64]:
        """Input frame → normalised frame, (n, 3) float64."""
        # Shift first, in double precision: a UTM northing has seven digits before the point.
        shifted = np.asarray(points, dtype=np.float64) - self.center
        shifted *= self.scale
        return shifted

    def to_input(self, points: NDArray[np.floating]) -> NDArray[np.float64]:
        """Normalised frame → input frame, (n, 3) float64."""
        moved = np.asarray(points, dtype=np.float64) / self.scale
        moved += self.center
        return moved

    def length_to_normalised(self, length: float) -> float:
        """A length in input units → in normalised units."""
        return length * self.scale

    def length_to_input(self, length: float) -> float:
        """A length in normalised units → in input units."""
        return length / self.scale
