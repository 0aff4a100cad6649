"""Scalar fields with their exact first and second derivatives, and the calculus on them.

A `Jet` holds value, gradient and Laplacian of one scalar field at n points. Sums, products and
smooth functions of jets follow the rules of calculus exactly, so composite fields such as
φ = r·P + θ are written as they stand in the paper and one backward pass through the result serves
every loss. Coordinates and lengths are in normalised units ([-1, 1]³).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from jaxtyping import Float
from torch import Tensor


class Order(IntEnum):
    """How many derivatives a jet carries."""

    VALUE = 0
    GRADIENT = 1
    LAPLACIAN = 2


@dataclass(frozen=True)
class Jet:
    """A scalar field at n points: value, and as far as carried, gradient and Laplacian."""

    value: Float[Tensor, " n"]
    gradient: Float[Tensor, "n 3"] | None = None
    laplacian: Float[Tensor, " n"] | None = None

    def __add__(self, other: Jet) -> Jet:
        gradient = laplacian = None
        if self.gradient is not None and other.gradient is not None:
            gradient = self.gradient + other.gradient
        if self.laplacian is not None and other.laplacian is not None:
            laplacian = self.laplacian + other.laplacian
        return Jet(self.value + other.value, gradient, laplacian)

    def __mul__(self, other: Jet) -> Jet:
        """∇(fg) = f∇g + g∇f and Δ(fg) = fΔg + 2∇f·∇g + gΔf."""
        f, g = self, other
        gradient = laplacian = None
        if f.gradient is not None and g.gradient is not None:
            gradient = f.value[:, None] * g.gradient + g.value[:, None] * f.gradient
            if f.laplacian is not None and g.laplacian is not None:
                cross = (f.gradient * g.gradient).sum(1)
                laplacian = f.value * g.laplacian + 2 * cross + g.value * f.laplacian
        return Jet(f.value * g.value, gradient, laplacian)

    def through(
        self,
        value: Float[Tensor, " n"],
        slope: Float[Tensor, " n"],
        curvature: Float[Tensor, " n"],
    ) -> Jet:
        """The jet of F∘f, given F, F′ and F″ at f: ∇ = F′∇f and Δ = F′Δf + F″|∇f|²."""
        gradient = laplacian = None
        if self.gradient is not None:
            gradient = slope[:, None] * self.gradient
            if self.laplacian is not None:
                squared = self.gradient.square().sum(1)
                laplacian = slope * self.laplacian + curvature * squared
        return Jet(value, gradient, laplacian)
