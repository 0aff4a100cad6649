"""The gradient of a step by hand against autograd through the losses, its definition."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from mpf_core.cloud.neighbors import analyse
from mpf_core.errors import Cancelled
from mpf_core.experiments.shapes import sample
from mpf_core.field import MetricPhaseField, plain, pointwise
from mpf_core.field.metric_phase import COMPOSITES
from mpf_core.field.pointwise import uncompiled
from mpf_core.field.sweeps import GradientSweep, LaplacianSweep, ValueSweep
from mpf_core.fit import adjoints, losses
from mpf_core.fit.batch import Stage, draw
from mpf_core.fit.compiled import prepare
from mpf_core.fit.initialize import initialize
from mpf_core.fit.objective import Objective
from mpf_core.fit.sampler import Pools, paper_pools, warm_pools
from mpf_core.fit_options import FitOptions
from mpf_core.options import PRESETS
from mpf_core.parallel import workers

ALONE, FADING, WITHOUT, ALL = (
    Stage(False, False, False, 1.0),
    Stage(True, True, True, 0.3),
    Stage(True, False, False, 0.0),
    Stage(True, True, True, 0.0),
)
OPTIONS = replace(
    PRESETS["balanced"].fit,
    surface_points=300,
    near_points=200,
    far_points=150,
    start_points=500,
    laplacian_points=33,
    # Each large enough that an error in it would be seen in the sum.
    weight_align=0.7,
    weight_eik_r=0.5,
    weight_eik_phi=0.5,
    weight_lap=0.01,
    weight_phase=0.5,
    weight_far=0.5,
)


@pytest.fixture(scope="module")
def pools() -> dict[str, Pools]:
    cloud = analyse(sample("cube-sheet", 2000, 0))
    rng = np.random.default_rng(0)
    warm = warm_pools(cloud.points, cloud, initialize(cloud), OPTIONS, rng, size=20_000)
    unsided = replace(warm.far, side=torch.where(warm.far.x[:, 0] > 0, warm.far.side, 0.0))
    lighter = torch.where(warm.normals[:, :1] > 0, 1.0, 0.15) * warm.normals
    return {
        "warm": warm,
        "normals in part lighter": replace(warm, normals=lighter),
        "thin walls": replace(
            warm, near=replace(warm.near, layered=(warm.near.x[:, 0] > 0).float())
        ),
        "sides in part unknown": replace(warm, far=unsided),
        "paper": paper_pools(cloud, rng, size=20_000),
    }


def gradients(
    pools: Pools, options: FitOptions, stage: Stage, threads: int = 1
) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
    generator = torch.Generator().manual_seed(3)
    field = MetricPhaseField(width=64, beta=20.0, composite=options.composite, generator=generator)
    field.siren.precision = torch.float32
    objective = Objective(field, pools, options, torch.Generator().manual_seed(0))
    with workers(threads):
        terms = {name: term.detach() for name, term in objective.backward(stage).items()}
    found = {n: p.grad for n, p in field.named_parameters() if p.grad is not None}
    return terms, found


def assert_alike(ours: dict[str, Tensor], others: dict[str, Tensor], share: float) -> None:
    assert ours.keys() == others.keys()
    for name, one in ours.items():
        scale = float(others[name].norm()) + 1e-9
        assert float((one - others[name]).norm()) < share * scale, name


def assert_as_by_autograd(pools: Pools, options: FitOptions, stage: Stage) -> dict[str, Tensor]:
    """The terms and their gradients by hand are autograd's; returns the terms."""
    terms, found = gradients(pools, options, stage)
    with uncompiled():
        plain_terms, plain = gradients(pools, options, stage)
    assert_alike(terms, plain_terms, 1e-5)
    assert_alike(found, plain, 3e-4)
    return terms


@pytest.mark.parametrize("composite", COMPOSITES)
@pytest.mark.parametrize("stage", [ALONE, FADING, WITHOUT, ALL])
def test_a_step_by_hand_is_that_of_autograd(
    pools: dict[str, Pools], composite: str, stage: Stage
) -> None:
    assert_as_by_autograd(pools["warm"], replace(OPTIONS, composite=composite), stage)


def test_blocks_do_not_matter(pools: dict[str, Pools], monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where the samples end within one, and the last is smaller."""
    whole = gradients(pools["warm"], OPTIONS, FADING)
    for sweep, block in ((GradientSweep, 64), (ValueSweep, 70), (LaplacianSweep, 16)):
        monkeypatch.setattr(sweep, "block", block)
    terms, found = gradients(pools["warm"], OPTIONS, FADING, threads=2)
    assert_alike(terms, whole[0], 1e-6)
    assert_alike(found, whole[1], 1e-4)


def test_constants_are_those_of_the_losses() -> None:
    for name in ("SOFT", "TINY", "SCALE"):
        assert getattr(adjoints, name) == getattr(losses, name)


def test_without_these_loops_nothing_is_compiled(
    pools: dict[str, Pools], monkeypatch: pytest.MonkeyPatch
) -> None:
    def full() -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(adjoints, "compilations", lambda: iter([full]))
    monkeypatch.setattr(pointwise, "_chosen", [pointwise.Choice()])
    assert prepare(torch.float32) is plain
    assert "No space left" in (pointwise.why_plain() or "")
    found = gradients(pools["warm"], OPTIONS, ALL)[1]
    with uncompiled():
        assert_alike(found, gradients(pools["warm"], OPTIONS, ALL)[1], 1e-6)


@pytest.mark.parametrize("folds", [False, True])
def test_align_at_folds(pools: dict[str, Pools], folds: bool) -> None:
    silent = {f"weight_{n}": 0.0 for n in adjoints.TERMS if n not in ("align", "regression")}
    options = replace(OPTIONS, **silent, align_at_folds=folds)
    terms = assert_as_by_autograd(pools["thin walls"], options, ALL)
    whole, _ = gradients(pools["warm"], options, ALL)
    assert torch.equal(terms["align"], whole["align"]) == folds


@pytest.mark.parametrize("kind", ["sides in part unknown", "normals in part lighter", "paper"])
def test_sides_and_normals_may_be_unknown_or_count_less(pools: dict[str, Pools], kind: str) -> None:
    assert_as_by_autograd(pools[kind], OPTIONS, ALL)


@pytest.mark.parametrize("name", [n for n in adjoints.TERMS if n != "regression"])
def test_each_term_alone(pools: dict[str, Pools], name: str) -> None:
    """So that none hides behind the others."""
    silent = {f"weight_{n}": 0.0 for n in adjoints.TERMS if n not in (name, "regression")}
    options = replace(OPTIONS, **{**silent, f"weight_{name}": 1.0})
    _, found = gradients(pools["warm"], options, ALL)
    with uncompiled():
        _, plain = gradients(pools["warm"], options, ALL)
    assert_alike(found, plain, 3e-4)


def test_threads_share_every_batch(pools: dict[str, Pools]) -> None:
    (terms, found), (shared_terms, shared) = (
        gradients(pools["warm"], OPTIONS, FADING, threads) for threads in (1, 3)
    )
    assert_alike(terms, shared_terms, 1e-6)
    assert_alike(found, shared, 1e-4)


def test_gradients_are_added_to_what_is_there(pools: dict[str, Pools]) -> None:
    field = MetricPhaseField(width=16, generator=torch.Generator().manual_seed(0))
    field.siren.precision = torch.float32
    objective = Objective(field, pools["warm"], OPTIONS, torch.Generator().manual_seed(0))
    objective.backward(ALL)
    once = {n: p.grad.clone() for n, p in field.named_parameters() if p.grad is not None}
    objective.generator.manual_seed(0)
    objective.backward(ALL)
    twice = {n: p.grad for n, p in field.named_parameters() if p.grad is not None}
    assert_alike(twice, {n: 2 * g for n, g in once.items()}, 1e-5)


def test_a_point_where_nothing_is_known_of_the_field_does_no_harm() -> None:
    """All slopes 0, as in a field that has just been made flat: bars are finite."""
    tally, weights = np.zeros(adjoints.TALLY), np.ones(len(adjoints.TERMS))
    constants = np.array([50.0, 100.0, 100.0, 1.0, 1.0])
    y, g = np.zeros((2, 4), np.float32), np.zeros((2, 4, 3), np.float32)
    y_bar, g_bar = np.full_like(y, np.nan), np.full_like(g, np.nan)
    normals = np.zeros((2, 3), np.float32)
    layered = np.ones(2, np.float32)
    adjoints.gradients(tally, y_bar, g_bar, y, g, normals, layered, 0, 2, 1, weights, constants)
    assert np.isfinite(tally).all() and np.isfinite(y_bar).all() and np.isfinite(g_bar).all()


def test_what_is_off_is_not_drawn(pools: dict[str, Pools]) -> None:
    generator = torch.Generator().manual_seed(0)
    alone = draw(pools["warm"], OPTIONS, ALONE, generator)
    assert alone.start is not None
    assert alone.surface is None and alone.far is None and alone.ambient is None
    whole = draw(pools["warm"], replace(OPTIONS, weight_lap=0.0), ALL, generator)
    assert whole.start is None and whole.ambient is None
    assert whole.surface is not None and len(whole.surface.x) == 500
    assert len(whole.surface.normals) == 300


def test_compiling_can_be_cancelled(monkeypatch: pytest.MonkeyPatch) -> None:
    compiled: list[None] = []
    compilations = adjoints.compilations
    monkeypatch.setattr(pointwise, "_chosen", [pointwise.Choice()])
    pointwise.functions_of_theta()
    pointwise.functions(torch.float32)  # the sweeps, so that only the terms are asked about
    monkeypatch.setattr(adjoints, "compilations", lambda: iter([lambda: compiled.append(None)] * 4))
    with pytest.raises(Cancelled, match="compiled"):
        prepare(torch.float32, lambda: len(compiled) == 2)
    assert len(compiled) == 2
    monkeypatch.setattr(adjoints, "compilations", compilations)
    assert prepare(torch.float32) is not plain
