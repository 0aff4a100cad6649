"""What a step of the fit costs, beside plain automatic differentiation of the same losses:
`mpf experiment cost`."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median

import numpy as np
import torch
from torch import Tensor

from mpf_core.cloud.neighbors import analyse
from mpf_core.experiments.asked import Asked
from mpf_core.experiments.shapes import sample
from mpf_core.experiments.trial import Row
from mpf_core.field import FieldJets, Jet, MetricPhaseField, Order
from mpf_core.field.metric_phase import phase_indicator, sharp_softplus
from mpf_core.field.pointwise import functions
from mpf_core.field.precision import products_in
from mpf_core.fit.batch import Stage
from mpf_core.fit.compiled import prepare
from mpf_core.fit.initialize import initialize
from mpf_core.fit.objective import Objective
from mpf_core.fit.optimizers import QUINTICS, Optimizer
from mpf_core.fit.sampler import warm_pools
from mpf_core.fit.trainer import first_frequency
from mpf_core.fit_options import FitOptions
from mpf_core.options import PRESETS
from mpf_core.parallel import shared, workers

SHAPE, POINTS, POOL = "cube-sheet", 10_000, 50_000
REPEATS = 15
SIDE = 2048  # rows of the matrices whose product gives the machine's rate


class PlainField(MetricPhaseField):
    """The same field with every derivative taken by automatic differentiation."""

    def forward(self, x: Tensor, order: Order = Order.VALUE) -> FieldJets:
        net = self.siren
        x = x.requires_grad_()
        s1 = (x @ net.input_weight.t() + net.input_bias).sin()
        s2 = (s1 @ net.shared_weight.t() + net.shared_bias).sin()
        metric = (s2 @ net.metric_weight.t() + net.metric_bias).sin() @ net.metric_output
        phase = (s2 @ net.phase_weight.t() + net.phase_bias).sin() @ net.phase_output
        raw, theta = Jet(metric + net.metric_offset), Jet(phase + net.phase_offset)
        r = sharp_softplus(raw, self.softplus_slope)
        indicator = phase_indicator(theta, self.beta)
        jets = (r, theta, indicator, r * indicator + theta)
        # P's own derivatives are in no loss.
        return FieldJets(*(jet if jet is indicator else _derived(jet, x, order) for jet in jets))


@dataclass(frozen=True)
class Cost:
    """Seconds of one step, and its matrix products' operations."""

    name: str
    seconds: float
    plain: float
    operations: float


def measured(directory: Path, asked: Asked, threads: int = 2) -> list[Row]:
    """The rows of the table; nothing is left in `directory`."""
    del directory
    costs, rates = timed(quick=asked.quick, threads=threads)
    kept = products_in(PRESETS["balanced"].fit.precision)
    precision = str(kept).removeprefix("torch.")
    rows: list[Row] = [
        {
            "step": cost.name,
            "ours, ms": 1e3 * cost.seconds,
            "plain autograd, ms": 1e3 * cost.plain,
            "ratio": cost.plain / cost.seconds,
            "GFLOP": cost.operations / 1e9,
            "our products in": precision,
            "loops": functions(kept).NAME,
            "share of their rate": cost.operations / cost.seconds / rates[precision],
        }
        for cost in costs
    ]
    # The regression takes part in 60 % of the iterations, the paper's terms in 52 %.
    mixed = {
        name: 0.6 * rows[0][name] + 0.52 * rows[1][name]
        for name in ("ours, ms", "plain autograd, ms")
    }
    ratio = mixed["plain autograd, ms"] / mixed["ours, ms"]
    rows.append({"step": "the mix of balanced", **mixed, "ratio": ratio})
    for name, rate in rates.items():
        rows.append({"step": f"{name} products, {threads} threads", "GFLOP/s": rate / 1e9})
    return rows


def timed(*, quick: bool, threads: int) -> tuple[list[Cost], dict[str, float]]:
    """Both kinds of steps of `balanced`, ours and plain, and the machine's rates, in one run."""
    options = PRESETS["balanced"].fit
    repeats = 3 if quick else REPEATS
    if quick:
        options = replace(options, surface_points=64, near_points=64, far_points=64)
        options = replace(options, start_points=256, laplacian_points=16, width=64)
    stages = {"regression": Stage(False, False, False, 1.0), "terms": Stage(True, True, True, 0.0)}
    prepare(products_in(options.precision))  # compiled before anything is timed
    with workers(threads):
        cloud = analyse(sample(SHAPE, POINTS, 0), threads=threads)
        start = initialize(cloud, threads=threads)
        rng = np.random.default_rng(0)
        pools = warm_pools(cloud.points, cloud, start, options, rng, size=POOL)
        steps: dict[tuple[str, str], Callable[[], None]] = {}
        for kind, made in (("ours", MetricPhaseField), ("plain", PlainField)):
            field = made(width=options.width, omega=first_frequency(options, pools.spacing))
            generator = torch.Generator().manual_seed(0)
            objective = Objective(field, pools, options, generator)
            precision = products_in(options.precision) if kind == "ours" else torch.float32
            field.siren.precision = precision
            for name, stage in stages.items():
                optimizer = Optimizer(field, options, precision)
                steps[kind, name] = _step(objective, optimizer, stage, plainly=kind == "plain")
        # Alternating, so that a change of the machine's pace meets all alike. Plain steps have
        # torch's own threads, which is what such code runs with.
        seconds: dict[tuple[str, str], list[float]] = {key: [] for key in steps}
        for _ in range(repeats + 1):
            for key, step in steps.items():
                torch.set_num_threads(threads if key[0] == "plain" else 1)
                step()  # after which caches hold its arrays, and no other's threads spin
                seconds[key].append(_seconds(step))
        torch.set_num_threads(1)
        rates = {str(kind).removeprefix("torch."): _rate(kind) for kind in _KINDS}
    costs = [
        Cost(
            name,
            median(seconds["ours", name][1:]),
            median(seconds["plain", name][1:]),
            operations(options, stage),
        )
        for name, stage in stages.items()
    ]
    return costs, rates


def operations(options: FitOptions, stage: Stage) -> float:
    """Floating-point operations of the h × h products of a step, forward and back."""
    product = 2.0 * options.width**2
    values, gradients, laplacians = 3 * 3, 7 * 3, 15 * 3  # products a point, back costs twice
    if not stage.terms:
        points = options.start_points * values
    else:
        points = (options.surface_points + options.near_points) * gradients
        points += options.far_points * values + options.laplacian_points * laplacians
    muon = 3 * len(QUINTICS) * 3 * options.width  # matrices, rounds, products of each
    return product * (points + (muon if options.optimizer == "muon" else 0))


_KINDS = (torch.float32, torch.bfloat16)


def _derived(jet: Jet, x: Tensor, order: Order) -> Jet:
    if order is Order.VALUE:
        return jet
    (gradient,) = torch.autograd.grad(jet.value.sum(), x, create_graph=True)
    if order is Order.GRADIENT:
        return Jet(jet.value, gradient)
    second = [
        torch.autograd.grad(gradient[:, i].sum(), x, create_graph=True)[0][:, i] for i in range(3)
    ]
    return Jet(jet.value, gradient, torch.stack(second).sum(0))


def _step(
    objective: Objective, optimizer: Optimizer, stage: Stage, *, plainly: bool = False
) -> Callable[[], None]:
    """One step; `plainly` leaves the derivatives of the terms to autograd as well."""

    def step() -> None:
        optimizer.zero_grad()
        if plainly:
            total = objective.total(objective.terms(stage), stage)
            total.backward()  # type: ignore[no-untyped-call]
        else:
            objective.backward(stage)
        optimizer.step(1e-3)  # small, so that all steps meet the same field

    return step


def _seconds(step: Callable[[], None]) -> float:
    begin = time.perf_counter()
    step()
    return time.perf_counter() - begin


def _rate(kind: torch.dtype) -> float:
    """Operations a second of products of (SIDE, 256) by (256, 256), on all threads."""
    a, b = torch.randn(SIDE, 256).to(kind), torch.randn(256, 256).to(kind)
    rounds = 8

    def work(part: slice) -> None:
        for _ in range(rounds * (part.stop - part.start)):
            a @ b

    def all_of_it() -> None:
        shared(work, 4)

    best = min(_seconds(all_of_it) for _ in range(5))
    return 2.0 * SIDE * 256 * 256 * rounds * 4 / best
