"""The derivatives carried by hand against automatic differentiation, in float64."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from mpf_core.field import MetricPhaseField, Order

TOLERANCE = 1e-10


@pytest.fixture
def field() -> MetricPhaseField:
    generator = torch.Generator().manual_seed(7)
    field = MetricPhaseField(width=32, omega=12.0, beta=5.0, generator=generator).double()
    with torch.no_grad():  # a field of the size of a shape, not of its initialisation
        field.siren.metric_output.mul_(8)
        field.siren.phase_output.mul_(8)
    return field


def by_autograd(field: MetricPhaseField, x: Tensor, name: str) -> tuple[Tensor, Tensor, Tensor]:
    x = x.clone().requires_grad_()
    value = getattr(field(x, Order.VALUE), name).value
    (gradient,) = torch.autograd.grad(value.sum(), x, create_graph=True)
    second = [
        torch.autograd.grad(gradient[:, i].sum(), x, create_graph=True)[0][:, i] for i in range(3)
    ]
    return value, gradient, torch.stack(second).sum(0)


def points(n: int = 40) -> Tensor:
    generator = torch.Generator().manual_seed(1)
    return torch.rand(n, 3, generator=generator, dtype=torch.float64) * 2 - 1


@pytest.mark.parametrize("name", ["r", "theta", "indicator", "phi"])
@pytest.mark.parametrize("order", [Order.GRADIENT, Order.LAPLACIAN])
def test_jets_equal_autograd(field: MetricPhaseField, name: str, order: Order) -> None:
    value, gradient, laplacian = by_autograd(field, points(), name)
    jet = getattr(field(points(), order), name)
    scale = 1 + laplacian.detach().abs().max()
    assert (jet.value - value).abs().max() < TOLERANCE
    assert (jet.gradient - gradient).abs().max() < TOLERANCE * (1 + gradient.abs().max())
    if order is Order.LAPLACIAN:
        assert (jet.laplacian - laplacian).abs().max() < TOLERANCE * scale
    else:
        assert jet.laplacian is None


def test_one_backward_pass_gives_the_gradients_of_double_backward(
    field: MetricPhaseField,
) -> None:
    """A loss of second derivatives, differentiated for the parameters both ways."""
    parameters = list(field.parameters())
    _, gradient, laplacian = by_autograd(field, points(), "phi")
    reference = torch.autograd.grad(
        gradient.norm(dim=1).mean() + laplacian.abs().mean(), parameters
    )
    phi = field(points(), Order.LAPLACIAN).phi
    ours = torch.autograd.grad(
        phi.gradient.norm(dim=1).mean() + phi.laplacian.abs().mean(), parameters
    )
    for mine, theirs in zip(ours, reference, strict=True):
        assert (mine - theirs).abs().max() < TOLERANCE * (1 + theirs.abs().max())


def test_the_phase_head_alone_agrees_with_the_whole_field(field: MetricPhaseField) -> None:
    whole = field(points(), Order.GRADIENT).theta
    alone = field.siren.phase_jet(points())
    assert torch.equal(field.theta(points()), field(points()).theta.value)
    torch.testing.assert_close(alone.value, whole.value)
    torch.testing.assert_close(alone.gradient, whole.gradient)
