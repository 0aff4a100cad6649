"""Muon's orthogonalised steps, the shared schedule, and who moves which parameter."""

from __future__ import annotations

import subprocess
import sys
from itertools import pairwise

import pytest
import torch
from torch import Tensor, nn

from mpf_core.field import MetricPhaseField
from mpf_core.fit.optimizers import Adam, Muon, Optimizer
from mpf_core.fit.schedule import LAST_RATE, RAMP, Schedule
from mpf_core.options import options_from


def random(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed))


def made(**changes: object) -> tuple[MetricPhaseField, Optimizer]:
    field = MetricPhaseField(width=16, generator=torch.Generator().manual_seed(0))
    return field, Optimizer(field, options_from(changes).fit)


def fill_gradients(field: MetricPhaseField, size: float = 1.0) -> None:
    for number, parameter in enumerate(field.parameters()):
        parameter.grad = size * random(*parameter.shape, seed=number)


@pytest.mark.parametrize("precision", [torch.float32, torch.bfloat16])
@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_singular_values_of_a_step_are_near_one(scale: float, precision: torch.dtype) -> None:
    matrices = [nn.Parameter(torch.zeros(48, 48)) for _ in range(3)]
    for seed, matrix in enumerate(matrices):
        matrix.grad = scale * random(48, 48, seed=seed)
    Muon(matrices, precision=precision).step(0.1)
    for matrix in matrices:
        values = torch.linalg.svdvals(matrix.detach()) / 0.1
        # The quintic of Jordan et al. lands between 0.7 and 1.2; the smallest lag behind.
        assert values.max() < 1.25
        assert values.median() > 0.7
        assert (values > 0.5).float().mean() > 0.9


def test_a_step_goes_down_the_gradient() -> None:
    matrix = nn.Parameter(torch.zeros(20, 20))
    matrix.grad = random(20, 20)
    Muon([matrix]).step(0.1)
    assert (matrix.detach() * matrix.grad).sum() < 0


def test_an_orthogonal_gradient_keeps_its_directions() -> None:
    q, _ = torch.linalg.qr(random(24, 24))
    matrix = nn.Parameter(torch.zeros(24, 24))
    matrix.grad = q
    Muon([matrix]).step(1.0)
    cosine = -(matrix.detach() * q).sum() / (matrix.detach().norm() * q.norm())
    assert cosine > 0.999


def test_a_gradient_of_zero_moves_nothing() -> None:
    matrix = nn.Parameter(torch.ones(8, 8))
    matrix.grad = torch.zeros(8, 8)
    Muon([matrix]).step(0.1)
    assert torch.equal(matrix.detach(), torch.ones(8, 8))


def rates(planned: int, **changes: object) -> list[float]:
    schedule = Schedule(options_from(changes).fit, normals=True)
    return [schedule.rate(iteration, planned) for iteration in range(planned)]


def test_the_rates_rise_are_held_and_fall_and_never_reach_zero() -> None:
    found = rates(1000, terms_rate=0.5)
    rise, hold, fall = found[:RAMP], found[RAMP:480], found[480:]
    assert rise == pytest.approx([(k + 1) / RAMP for k in range(RAMP)])
    assert set(hold) == {1.0}
    assert all(a >= b for a, b in pairwise(fall))
    assert fall[0] == pytest.approx(0.5)
    assert fall[260] == pytest.approx(0.25)
    assert found[-1] == LAST_RATE


def test_without_a_regression_the_rates_fall_from_the_start() -> None:
    found = rates(1000, warm_start=False)
    assert found[500] == pytest.approx(0.5)
    assert all(a >= b for a, b in pairwise(found[RAMP:]))


def test_the_constant_schedule_is_constant() -> None:
    assert set(rates(50, schedule="constant")) == {1.0}


@pytest.mark.parametrize("kind", ["adam", "muon"])
def test_every_parameter_is_moved_once(kind: str) -> None:
    field, optimizer = made(optimizer=kind)
    before = [p.detach().clone() for p in field.parameters()]
    fill_gradients(field)
    optimizer.step(0.5)
    for old, new in zip(before, field.parameters(), strict=True):
        assert not torch.equal(old, new)
    held = {id(p) for p in optimizer.adam.parameters}
    turned = {id(p) for p in field.siren.square_matrices()}
    assert held & turned == (turned if kind == "adam" else set())
    optimizer.zero_grad()
    assert all(p.grad is None for p in field.parameters())


def test_adam_takes_the_steps_of_torch() -> None:
    """Also of a parameter that has no gradient at first."""
    ours, theirs = ([nn.Parameter(random(7, 5)) for _ in range(2)] for _ in range(2))
    adam = Adam(ours, (0.9, 0.99))
    other = torch.optim.Adam(theirs, betas=(0.9, 0.99))
    for seed, rate in enumerate((1e-2, 3e-3, 1e-3, 2e-3)):
        for k in range(2) if seed > 1 else range(1):
            ours[k].grad = theirs[k].grad = random(7, 5, seed=10 * seed + k + 1)
        adam.step([rate, rate])
        other.param_groups[0]["lr"] = rate
        other.step()
        for one, twin in zip(ours, theirs, strict=True):
            assert torch.allclose(one, twin, rtol=0, atol=1e-8)


def test_no_compiler_is_loaded_for_a_step() -> None:
    """Which takes two seconds of every run."""
    program = (
        "import sys, torch; from mpf_core.field import MetricPhaseField as F;"
        "from mpf_core.fit.optimizers import Optimizer; from mpf_core.options import options_from;"
        "field = F(width=16, generator=torch.Generator());"
        "Optimizer(field, options_from({}).fit);"
        "print('torch._dynamo' in sys.modules)"
    )
    told = subprocess.run([sys.executable, "-c", program], capture_output=True, check=True)
    assert told.stdout.strip() == b"False"


def test_beta_has_a_rate_of_its_own_that_does_not_decay() -> None:
    field, optimizer = made(beta_learning_rate=1e-4)
    for done in (0.0, 0.99):
        before = field.beta.item()
        field.beta.grad = torch.tensor(1.0)
        fill_gradients(field)
        field.beta.grad = torch.tensor(1.0)
        optimizer.step(1 - done)
        assert before - field.beta.item() == pytest.approx(1e-4, rel=0.1)


def test_half_the_rate_halves_the_steps() -> None:
    moved = []
    for rate in (1.0, 0.5):
        field = MetricPhaseField(width=16, generator=torch.Generator().manual_seed(0))
        optimizer = Optimizer(field, options_from({}).fit)
        before = field.siren.shared_weight.detach().clone()
        fill_gradients(field)
        optimizer.step(rate)
        moved.append((field.siren.shared_weight.detach() - before).norm().item())
    assert moved[1] == pytest.approx(moved[0] / 2, rel=1e-4)


@pytest.mark.parametrize("kind", ["adam", "muon"])
def test_a_state_that_is_restored_leads_to_the_same_step(kind: str) -> None:
    field, optimizer = made(optimizer=kind)
    for _ in range(3):
        fill_gradients(field)
        optimizer.step(1.0)
    twin, other = made(optimizer=kind)
    twin.load_state_dict(field.state_dict())
    other.restore(optimizer.state())
    for one, way in ((field, optimizer), (twin, other)):
        fill_gradients(one)
        way.step(1.0)
    assert all(
        torch.equal(p, q) for p, q in zip(field.parameters(), twin.parameters(), strict=True)
    )


def test_the_whole_gradient_is_clipped() -> None:
    field, optimizer = made(optimizer="adam", gradient_clip=1e-3)
    fill_gradients(field, 1e3)
    optimizer.step(1.0)
    whole = torch.cat([p.grad.flatten() for p in field.parameters() if p.grad is not None])
    assert whole.norm().item() == pytest.approx(1e-3, rel=1e-3)
