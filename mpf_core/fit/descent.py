"""The gradient of a step's objective by hand, through the terms (`adjoints`) and the network."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mpf_core.field import MetricPhaseField
from mpf_core.field.fused import array_of
from mpf_core.field.sweeps import GradientSweep, LaplacianSweep, Part, ValueSweep
from mpf_core.fit import adjoints
from mpf_core.fit.batch import Batch, Stage
from mpf_core.fit_options import FitOptions

Tally = NDArray[np.float64]
Tensors = tuple[Tensor, ...]
Bars = Callable[[Tensors, slice, Tally], Tensors]


def descend(
    field: MetricPhaseField,
    batch: Batch,
    stage: Stage,
    weights: dict[str, float],
    options: FitOptions,
    *,
    oriented: bool,
) -> dict[str, Tensor]:
    """Add the derivatives of the weighted terms of a batch to the parameters'.

    weights: λ by the name of a term; what is off at `stage` is left out. oriented: whether normals
    have a side. Returns the unweighted terms that are on.
    """
    on = _counts(batch, stage)
    scaled = np.array([weights[n] / on[n] if n in on else 0.0 for n in adjoints.TERMS])
    parts = _parts(batch, scaled, _constants(field, options), oriented)
    tally = field.siren.descend(parts, adjoints.TALLY)
    if stage.terms:  # the regression alone does not know β
        bar = torch.tensor(tally[adjoints.BETA], dtype=field.beta.dtype)
        field.beta.grad = bar if field.beta.grad is None else field.beta.grad + bar
    places = {name: adjoints.TERMS.index(name) for name in on}
    return {name: torch.tensor(tally[at] / on[name]) for name, at in places.items()}


def _counts(batch: Batch, stage: Stage) -> dict[str, int]:
    """Over how many points each term that is on is a mean, in the order of `Objective.terms`."""
    counts: dict[str, int] = {}
    if batch.surface is not None and batch.far is not None:
        samples = len(batch.surface.normals)
        band = len(batch.surface.x) - samples
        counts |= {"zero": samples, "eik_r": band, "eik_phi": samples}
        if stage.align:
            counts["align"] = band
        if stage.normal:
            counts["normal"] = samples
        counts |= {"phase": len(batch.far.x), "far": len(batch.far.x)}
    if batch.start is not None:
        counts["regression"] = len(batch.start.x)
    if batch.ambient is not None:
        counts["lap"] = len(batch.ambient)
    return counts


def _constants(field: MetricPhaseField, options: FitOptions) -> Tally:
    """As `adjoints` takes them."""
    beta = float(field.beta.detach())
    rho = 0.0 if field.composite == "phase" else 1.0
    kappa = 1.0 if field.composite == "residual" else 0.0
    return np.array([beta, field.softplus_slope, options.alpha, rho, kappa])


def _parts(batch: Batch, weights: Tally, constants: Tally, oriented: bool) -> list[Part]:
    """The largest first; each with the loop that says what is asked for there."""

    def of_values(loop: Any, *known: Any) -> Bars:
        def bars(outputs: Tensors, rows: slice, tally: Tally) -> Tensors:
            y_bar = torch.empty_like(outputs[0])
            y = array_of(outputs[0])
            loop(tally, array_of(y_bar), y, *known, rows.start, weights, constants)
            return (y_bar,)

        return bars

    parts = []
    if batch.surface is not None:
        surface = batch.surface
        normals, layered = array_of(surface.normals), array_of(surface.layered)

        def on_surface(outputs: Tensors, rows: slice, tally: Tally) -> Tensors:
            y_bar, g_bar = bars = tuple(torch.empty_like(one) for one in outputs)
            y, g = map(array_of, outputs)
            adjoints.gradients(
                tally, array_of(y_bar), array_of(g_bar), y, g, normals, layered, rows.start,
                len(normals), int(oriented), weights, constants,
            )  # fmt: skip
            return bars

        parts.append(Part(GradientSweep, surface.x, on_surface))
    if batch.start is not None:
        targets = array_of(batch.start.theta), array_of(batch.start.r)
        parts.append(Part(ValueSweep, batch.start.x, of_values(adjoints.regressions, *targets)))
    if batch.far is not None:
        side = batch.far.side
        sides = np.zeros(len(batch.far.x), np.float32) if side is None else array_of(side)
        parts.append(Part(ValueSweep, batch.far.x, of_values(adjoints.values, sides)))
    if batch.ambient is not None:

        def around(outputs: Tensors, _: slice, tally: Tally) -> Tensors:
            y, g, laplacian = (one.contiguous() for one in outputs)
            bars = tuple(torch.empty_like(one) for one in (y, g, laplacian))
            arrays = map(array_of, (*bars, y, g, laplacian))
            adjoints.laplacians(tally, *arrays, weights, constants)
            return bars

        parts.append(Part(LaplacianSweep, batch.ambient, around))
    return parts
