"""The objective of one step: batches drawn from the pools, the terms, their weighted sum."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from mpf_core.field import FieldJets, Jet, MetricPhaseField, Order
from mpf_core.fit import losses
from mpf_core.fit.sampler import Pools
from mpf_core.options import FitOptions

EXAMINED = 4096  # points of each kind by which states of the fit are compared


@dataclass(frozen=True)
class Stage:
    """Which terms are on at one moment of the fit; `regression` is the warm start's weight.

    `terms` is False while the regression runs alone, which costs a third of a whole step.
    """

    terms: bool
    align: bool
    normal: bool
    regression: float


@dataclass(frozen=True)
class Examination:
    """Samples (n, 3) and points of free space (n, 3) with their side (n,), where known."""

    surface: Float[Tensor, "n 3"]
    far: Float[Tensor, "n 3"]
    side: Float[Tensor, " n"] | None


@dataclass(frozen=True)
class Objective:
    """Draws the batches of a step and evaluates the terms that are on."""

    field: MetricPhaseField
    pools: Pools
    options: FitOptions
    generator: torch.Generator

    def terms(self, stage: Stage) -> dict[str, Tensor]:
        """The unweighted terms, by name; only those with a weight."""
        if not stage.terms:
            return {"regression": self._regression()}
        terms = self._gradient_terms(stage) | self._far_terms()
        if stage.regression > 0:
            terms["regression"] = self._regression()
        if self.options.weight_lap and self.options.laplacian_points:
            ambient = self.pools.ambient
            x = ambient.x[self._draw(len(ambient), self.options.laplacian_points)]
            terms["lap"] = losses.laplacian_loss(self.field(x, Order.LAPLACIAN).phi)
        return terms

    def points(self, stage: Stage) -> int:
        """At how many points `terms` evaluates the field."""
        options = self.options
        points = options.start_points if stage.regression > 0 or not stage.terms else 0
        if stage.terms:
            points += options.surface_points + options.near_points + options.far_points
            points += options.laplacian_points if options.weight_lap else 0
        return points

    def backward(self, stage: Stage) -> dict[str, Tensor]:
        """`terms` of one batch, with the gradients of their `total` added to the parameters'."""
        terms = self.terms(stage)
        self.total(terms, stage).backward()  # type: ignore[no-untyped-call]
        return terms

    def total(self, terms: dict[str, Tensor], stage: Stage) -> Float[Tensor, ""]:
        """The weighted sum (the paper's objective, plus the regression while it lasts)."""
        weights = {**loss_weights(self.options), "regression": stage.regression}
        return torch.stack([weights[name] * term for name, term in terms.items()]).sum()

    def examination(self, seed: int) -> Examination:
        """Points to judge states of the fit by, the same ones each time."""
        generator = torch.Generator().manual_seed(seed)
        surface, far = self.pools.surface, self.pools.far
        on = torch.randint(len(surface), (EXAMINED,), generator=generator)
        off = torch.randint(len(far), (EXAMINED,), generator=generator)
        return Examination(surface[on], far.x[off], None if far.side is None else far.side[off])

    @torch.no_grad()
    def examined(self, points: Examination) -> float:
        """How far the surface is from the samples, and free space from being free."""
        options = self.options
        on = self.field(points.surface, Order.VALUE)
        off = self.field(points.far, Order.VALUE)
        value = options.weight_zero * losses.zero_loss(on)
        value = value + options.weight_phase * losses.phase_loss(off.indicator, points.side)
        return float(value + options.weight_far * losses.far_loss(off, options.alpha))

    def _gradient_terms(self, stage: Stage) -> dict[str, Tensor]:
        options, pools = self.options, self.pools
        on = self._draw(len(pools.surface), options.surface_points)
        near = self._draw(len(pools.near), options.near_points)
        x = torch.cat([pools.surface[on], pools.near.x[near]])
        fields = self.field(x, Order.GRADIENT)
        surface, band = _split(fields, len(on))
        terms = {
            "zero": losses.zero_loss(surface),
            "eik_r": losses.metric_eikonal_loss(band.r),
            "eik_phi": losses.interface_eikonal_loss(surface.phi, surface.theta),
        }
        if stage.align:
            terms["align"] = losses.align_loss(band.r, band.theta, options.alpha)
        if stage.normal:
            terms["normal"] = losses.normal_loss(
                surface.phi, pools.normals[on], oriented=pools.start is not None
            )
        return terms

    def _far_terms(self) -> dict[str, Tensor]:
        far = self.pools.far
        pick = self._draw(len(far), self.options.far_points)
        fields = self.field(far.x[pick], Order.VALUE)
        side = far.side[pick] if far.side is not None else None
        return {
            "phase": losses.phase_loss(fields.indicator, side),
            "far": losses.far_loss(fields, self.options.alpha),
        }

    def _regression(self) -> Tensor:
        start = self.pools.start
        assert start is not None and start.theta is not None and start.r is not None
        pick = self._draw(len(start), self.options.start_points)
        fields = self.field(start.x[pick], Order.VALUE)
        return losses.regression_loss(fields, start.theta[pick], start.r[pick])

    def _draw(self, size: int, count: int) -> Tensor:
        return torch.randint(size, (count,), generator=self.generator)


def loss_weights(options: FitOptions) -> dict[str, float]:
    """λ of every term of the paper, by the name `Objective.terms` gives it."""
    names = ("zero", "align", "eik_r", "eik_phi", "lap", "phase", "far", "normal")
    return {name: getattr(options, f"weight_{name}") for name in names}


def _split(fields: FieldJets, at: int) -> tuple[FieldJets, FieldJets]:
    def part(jet: Jet, where: slice) -> Jet:
        gradient = None if jet.gradient is None else jet.gradient[where]
        return Jet(jet.value[where], gradient)

    def parts(where: slice) -> FieldJets:
        jets = (fields.r, fields.theta, fields.indicator, fields.phi)
        return FieldJets(*(part(jet, where) for jet in jets))

    return parts(slice(None, at)), parts(slice(at, None))
