"""Many fitted fields as one: φ = Σ wᵢ φᵢ with a partition of unity, each φᵢ in the whole's units.

A field knows the samples of its own tile only. Far from all samples, where the whole's free space
is known, that says the side, and no network is asked. Elsewhere those are asked that have weight:
one in most places, whose θ has the zeros of its φ (Proposition 1), two or more near cuts.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from mpf_core.cloud.normalize import Similarity
from mpf_core.field.fitted import Evaluate, Values, field_of, gradient_of, theta_of
from mpf_core.field.footprint import Footprint
from mpf_core.field.metric_phase import MetricPhaseField
from mpf_core.field.partition import Partition, Share

Array = NDArray[np.float64]
Names = tuple[str, ...]


@dataclass(frozen=True)
class Side:
    """Where the side is known from the whole cloud: +1 outside, −1 inside, 0 near the samples.

    labels: (k, k, k) int8 at voxels whose centres go from −half to half along each axis,
    normalised units of the whole
    """

    labels: NDArray[np.int8]
    half: float

    @property
    def voxel(self) -> float:
        """Edge of a voxel."""
        return 2 * self.half / (len(self.labels) - 1)

    def at(self, x: Array) -> NDArray[np.int8]:
        """(n,) the label of the voxel that holds each point of x (n, 3)."""
        index = np.clip(np.rint((x + self.half) / self.voxel), 0, len(self.labels) - 1)
        i, j, k = index.astype(np.int64).T
        return np.asarray(self.labels[i, j, k])

    @cached_property
    def away(self) -> NDArray[np.float32]:
        """(k, k, k) voxels from each to where networks are asked, made when it is first wanted."""
        return np.asarray(ndimage.distance_transform_edt(self.labels != 0), dtype=np.float32)

    def distance(self, x: Array) -> Array:
        """(n,) from points x (n, 3) to where networks are asked, about a voxel too much: nobody
        comes as close to samples as that."""
        place = (x + self.half).T / self.voxel
        found = ndimage.map_coordinates(self.away, place, order=1, mode="nearest")
        return self.voxel * (1 + np.asarray(found, dtype=np.float64))


@dataclass(frozen=True)
class Tile:
    """One network; `similarity` leads from the input's frame to its own."""

    field: MetricPhaseField
    similarity: Similarity


@dataclass(frozen=True)
class BlendedField:
    """The fields of tiles with everything that later extractions need of them together.

    `similarity` leads from the input's frame to the whole's normalised one, in which partition,
    `box` (2, 3) and footprint are; each tile has its own frame.
    """

    tiles: tuple[Tile, ...]
    partition: Partition
    side: Side
    similarity: Similarity
    box: Array
    footprint: Footprint

    @property
    def networks(self) -> int:
        """How many there are."""
        return len(self.tiles)

    def level(self) -> Evaluate:
        """Σ wᵢ φᵢ, and θ in place of φ where one tile alone has weight."""
        return self._shared("theta", "phi")

    def values(self, name: str) -> Evaluate:
        """Σ wᵢ of φ, r or θ, in the whole's units, or of P."""
        return self._shared(name, name)

    def gradient(self) -> Evaluate:
        """Σ wᵢ ∇θᵢ; what ∇wᵢ adds vanishes with φᵢ, on the surface."""

        def evaluate(x: Array) -> Values:
            out = np.zeros((len(x), 3))
            for share in self.partition.shares(x):
                found = gradient_of(self.tiles[share.tile].field)(self._own(share, x))
                out[share.rows] += share.weights[:, None] * found
            return out.astype(np.float32)

        return evaluate

    def _shared(self, alone: str, together: str) -> Evaluate:
        _ = self.side.away  # made once, and not by each of the threads that will call
        return lambda x: self._scalar(x, alone, together)

    def _scalar(self, x: Array, alone: str, together: str) -> Values:
        label = self.side.at(x)
        out = np.zeros(len(x))
        far = np.flatnonzero(label)
        out[far] = label[far] if alone == "P" else self._far(alone, label[far], x[far])
        near = np.flatnonzero(label == 0)
        for share in self.partition.shares(x[near]):
            single = share.weights == 1
            for rows, name in ((single, alone), (~single, together)):
                part = Share(share.tile, near[share.rows[rows]], share.weights[rows])
                if len(part.rows):
                    out[part.rows] += part.weights * self._values(part, x, name)
        return out.astype(np.float32)

    def _far(self, name: str, label: NDArray[np.int8], x: Array) -> Array:
        """Of r = d, θ = ±d and φ = r·P + θ, far from the samples."""
        distance = self.side.distance(x)
        return distance if name == "r" else label * distance * (2.0 if name == "phi" else 1.0)

    def _values(self, share: Share, x: Array, name: str) -> Array:
        tile = self.tiles[share.tile]
        evaluate = theta_of(tile.field) if name == "theta" else field_of(tile.field, name)
        unit = 1.0 if name == "P" else self.similarity.scale / tile.similarity.scale
        return unit * evaluate(self._own(share, x)).astype(np.float64)

    def _own(self, share: Share, x: Array) -> Array:
        """Those points in the frame of the tile."""
        tile = self.tiles[share.tile].similarity
        shift = (self.similarity.center - tile.center) * tile.scale
        return x[share.rows] * (tile.scale / self.similarity.scale) + shift
