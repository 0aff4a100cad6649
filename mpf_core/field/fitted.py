"""A fitted field as plain functions over numpy arrays, in chunks that stay in the cache."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray

from mpf_core.cloud.normalize import Similarity
from mpf_core.field.footprint import Footprint
from mpf_core.field.jet import Order
from mpf_core.field.metric_phase import MetricPhaseField
from mpf_core.parallel import shared

CHUNK = 1024  # 256 units × 1024 points × 4 bytes = 1 MiB a layer: four took a fifth longer
NAMES = ("phi", "r", "theta", "P")

Values = NDArray[np.float32]
Evaluate = Callable[[NDArray[np.float64]], Values]


class Fitted(Protocol):
    """What extractions ask of a field, be it of one network or of many (`blend.BlendedField`).

    Functions take points (n, 3) of the normalised frame; lengths are in its units.
    """

    @property
    def similarity(self) -> Similarity: ...
    @property
    def box(self) -> NDArray[np.float64]: ...
    @property
    def footprint(self) -> Footprint: ...
    @property
    def networks(self) -> int: ...
    def level(self) -> Evaluate:
        """(n,) whose zero level is the surface, negative inside."""

    def values(self, name: str) -> Evaluate:
        """(n,) of one of φ, r, θ, P, by its name in NAMES."""

    def gradient(self) -> Evaluate:
        """(n, 3) along the outward normal on the surface."""


@dataclass(frozen=True)
class FittedField:
    """A field with everything that later extractions need.

    `field` takes normalised coordinates, to which `similarity` leads from the input's; `box` (2, 3)
    is the part of the normalised frame that the fit saw.
    """

    field: MetricPhaseField
    similarity: Similarity
    box: NDArray[np.float64]
    footprint: Footprint
    networks = 1

    def level(self) -> Evaluate:
        """θ, whose zero level is that of φ (Proposition 1)."""
        return theta_of(self.field)

    def values(self, name: str) -> Evaluate:
        """One of φ, r, θ, P."""
        return field_of(self.field, name)

    def gradient(self) -> Evaluate:
        """∇θ."""
        return gradient_of(self.field)


def theta_of(field: MetricPhaseField) -> Callable[[NDArray[np.float64]], Values]:
    """θ at normalised points (n, 3)."""
    return _chunked(field.theta)


def field_of(field: MetricPhaseField, name: str) -> Callable[[NDArray[np.float64]], Values]:
    """One of φ, r, θ, P at normalised points (n, 3), by its name in NAMES."""
    attribute = {"P": "indicator"}.get(name, name)

    def evaluate(x: torch.Tensor) -> torch.Tensor:
        values: torch.Tensor = getattr(field(x, Order.VALUE), attribute).value
        return values

    return _chunked(evaluate)


def gradient_of(field: MetricPhaseField) -> Callable[[NDArray[np.float64]], Values]:
    """∇θ (n, 3) at normalised points; on the surface it is the outward normal."""

    def evaluate(x: torch.Tensor) -> torch.Tensor:
        gradient = field.siren.phase_jet(x).gradient
        assert gradient is not None
        return gradient

    return _chunked(evaluate)


def _chunked(
    evaluate: Callable[[torch.Tensor], torch.Tensor],
) -> Callable[[NDArray[np.float64]], Values]:
    def all_of(points: NDArray[np.float64]) -> Values:
        x = torch.from_numpy(np.ascontiguousarray(points, dtype=np.float32))

        def part(rows: slice) -> torch.Tensor:
            with torch.inference_mode():
                return torch.cat([evaluate(chunk) for chunk in torch.split(x[rows], CHUNK)])

        values: Values = torch.cat(shared(part, len(x), smallest=CHUNK)).numpy()
        return values

    return all_of
