"""The objective of one step: batches drawn from the pools, the terms, their weighted sum."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from mpf_core.field import FieldJets, Jet, MetricPhaseField, Order
from mpf_core.fit import losses
from mpf_core.fit.batch import Batch, Stage, Surface, draw
from mpf_core.fit.sampler import Pools
from mpf_core.fit_options import FitOptions

EXAMINED = 4096  # points of each kind by which states of the fit are compared


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
        """The unweighted terms of one batch, by name; only those with a weight."""
        return self._terms(self._drawn(stage), stage)

    def points(self, stage: Stage) -> int:
        """At how many points `terms` evaluates the field."""
        options = self.options
        points = options.start_points if stage.regression > 0 or not stage.terms else 0
        if stage.terms:
            points += options.surface_points + options.near_points + options.far_points
            points += options.laplacian_points if options.weight_lap else 0
        return points

    def backward(self, stage: Stage) -> dict[str, Tensor]:
        """`terms` of one batch, with the gradients of their `total` added to the parameters'.

        By hand where loops are compiled (`descent`), else by autograd.
        """
        batch = self._drawn(stage)
        if self.field.siren.compiled:
            from mpf_core.fit.descent import descend  # loads the compiler, which may not be there

            weights, options = self._weights(stage), self.options
            return descend(self.field, batch, stage, weights, options, oriented=self._oriented)
        terms = self._terms(batch, stage)
        self.total(terms, stage).backward()  # type: ignore[no-untyped-call]
        return terms

    def total(self, terms: dict[str, Tensor], stage: Stage) -> Float[Tensor, ""]:
        """The weighted sum (the paper's objective, plus the regression while it lasts)."""
        weights = self._weights(stage)
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

    @property
    def _oriented(self) -> bool:
        """A warm start has made the normals consistent."""
        return self.pools.start is not None

    def _drawn(self, stage: Stage) -> Batch:
        return draw(self.pools, self.options, stage, self.generator)

    def _weights(self, stage: Stage) -> dict[str, float]:
        return {**loss_weights(self.options), "regression": stage.regression}

    def _terms(self, batch: Batch, stage: Stage) -> dict[str, Tensor]:
        terms: dict[str, Tensor] = {}
        if batch.surface is not None:
            terms |= self._surface_terms(batch.surface, stage)
        if batch.far is not None:
            fields = self.field(batch.far.x, Order.VALUE)
            terms["phase"] = losses.phase_loss(fields.indicator, batch.far.side)
            terms["far"] = losses.far_loss(fields, self.options.alpha)
        if batch.start is not None:
            fields = self.field(batch.start.x, Order.VALUE)
            terms["regression"] = losses.regression_loss(fields, batch.start.theta, batch.start.r)
        if batch.ambient is not None:
            terms["lap"] = losses.laplacian_loss(self.field(batch.ambient, Order.LAPLACIAN).phi)
        return terms

    def _surface_terms(self, points: Surface, stage: Stage) -> dict[str, Tensor]:
        fields = self.field(points.x, Order.GRADIENT)
        surface, band = _split(fields, len(points.normals))
        terms = {
            "zero": losses.zero_loss(surface),
            "eik_r": losses.metric_eikonal_loss(band.r),
            "eik_phi": losses.interface_eikonal_loss(surface.phi, surface.theta),
        }
        if stage.align:
            terms["align"] = losses.align_loss(
                band.r, band.theta, self.options.alpha, points.layered
            )
        if stage.normal:
            terms["normal"] = losses.normal_loss(
                surface.phi, points.normals, oriented=self._oriented
            )
        return terms


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
