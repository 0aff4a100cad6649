"""The derivatives carried by hand against automatic differentiation, in float64."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from mpf_core.field import MetricPhaseField, Order
from mpf_core.parallel import workers

TOLERANCE = 1e-10


@pytest.fixture
def field() -> MetricPhaseField:
    generator = torch.Generator().manual_seed(7)
    field = MetricPhaseField(width=32, omega=12.0, beta=5.0, generator=generator).double()
    with torch.no_grad():  # a field of the size of a shape, not of its initialisation
        field.siren.metric_output.mul_(8)
        field.siren.phase_output.mul_(8)
    return field


def plainly(field: MetricPhaseField, x: Tensor, name: str) -> Tensor:
    """One of the four fields at x, written as in section 3 of the paper."""
    net = field.siren
    shared = (x @ net.input_weight.t() + net.input_bias).sin()
    shared = (shared @ net.shared_weight.t() + net.shared_bias).sin()
    metric = (shared @ net.metric_weight.t() + net.metric_bias).sin()
    phase = (shared @ net.phase_weight.t() + net.phase_bias).sin()
    raw = metric @ net.metric_output + net.metric_offset
    r = torch.log1p(torch.exp(field.softplus_slope * raw)) / field.softplus_slope
    theta = phase @ net.phase_output + net.phase_offset
    indicator = torch.tanh(field.beta * theta)
    phi = {
        "residual": r * indicator + theta,
        "product": r * indicator,
        "phase": indicator,
    }[field.composite]
    return {"r": r, "theta": theta, "indicator": indicator, "phi": phi}[name]


def by_autograd(field: MetricPhaseField, x: Tensor, name: str) -> tuple[Tensor, Tensor, Tensor]:
    x = x if x.requires_grad else x.clone().requires_grad_()
    value = plainly(field, x, name)
    (gradient,) = torch.autograd.grad(value.sum(), x, create_graph=True)
    second = [
        torch.autograd.grad(gradient[:, i].sum(), x, create_graph=True)[0][:, i] for i in range(3)
    ]
    return value, gradient, torch.stack(second).sum(0)


def points(n: int = 40) -> Tensor:
    generator = torch.Generator().manual_seed(1)
    return torch.rand(n, 3, generator=generator, dtype=torch.float64) * 2 - 1


@pytest.mark.parametrize("name", ["r", "theta", "indicator", "phi"])
@pytest.mark.parametrize("order", list(Order))
def test_jets_equal_autograd(field: MetricPhaseField, name: str, order: Order) -> None:
    value, gradient, laplacian = by_autograd(field, points(), name)
    jet = getattr(field(points(), order), name)
    scale = 1 + laplacian.detach().abs().max()
    assert (jet.value - value).abs().max() < TOLERANCE
    if order is Order.VALUE:
        assert jet.gradient is None
    else:
        assert (jet.gradient - gradient).abs().max() < TOLERANCE * (1 + gradient.abs().max())
    if order is Order.LAPLACIAN:
        assert (jet.laplacian - laplacian).abs().max() < TOLERANCE * scale
    else:
        assert jet.laplacian is None


@pytest.mark.parametrize("composite", ["product", "phase"])
def test_what_ablations_put_in_the_place_of_phi(field: MetricPhaseField, composite: str) -> None:
    field.composite = composite
    value, gradient, laplacian = by_autograd(field, points(), "phi")
    jet = field(points(), Order.LAPLACIAN).phi
    scale = 1 + laplacian.detach().abs().max()
    assert (jet.value - value).abs().max() < TOLERANCE
    assert (jet.gradient - gradient).abs().max() < TOLERANCE * (1 + gradient.abs().max())
    assert (jet.laplacian - laplacian).abs().max() < TOLERANCE * scale


def test_an_unknown_composite_is_refused() -> None:
    with pytest.raises(ValueError, match="sum"):
        MetricPhaseField(width=8, composite="sum")(points(2).float())


@pytest.mark.parametrize("threads", [1, 2, 3])
@pytest.mark.parametrize("order", list(Order))
def test_one_backward_pass_gives_the_gradients_of_double_backward(
    field: MetricPhaseField, order: Order, threads: int
) -> None:
    """A loss of all derivatives carried, differentiated for points and parameters both ways."""
    x = points(200).requires_grad_()

    def loss(jets: dict[str, tuple[Tensor, ...]]) -> Tensor:
        parts = [(one * one.detach().cos()).sum() for jet in jets.values() for one in jet]
        return torch.stack(parts).sum()

    def ours() -> dict[str, tuple[Tensor, ...]]:
        fields = field(x, order)
        jets = {name: getattr(fields, name) for name in ("r", "theta", "indicator", "phi")}
        return {n: (j.value, j.gradient, j.laplacian)[: order + 1] for n, j in jets.items()}

    def theirs() -> dict[str, tuple[Tensor, ...]]:
        names = ("r", "theta", "indicator", "phi")
        return {name: by_autograd(field, x, name)[: order + 1] for name in names}

    wanted = [x, *field.parameters()]
    reference = torch.autograd.grad(loss(theirs()), wanted)
    with workers(threads):
        found = torch.autograd.grad(loss(ours()), wanted)
    for mine, other in zip(found, reference, strict=True):
        assert (mine - other).abs().max() < TOLERANCE * (1 + other.abs().max())


def test_the_phase_head_alone_agrees_with_the_whole_field(field: MetricPhaseField) -> None:
    whole = field(points(), Order.GRADIENT).theta
    alone = field.siren.phase_jet(points())
    torch.testing.assert_close(field.theta(points()), field(points()).theta.value)
    torch.testing.assert_close(alone.value, whole.value)
    torch.testing.assert_close(alone.gradient, whole.gradient)


@pytest.mark.parametrize("order", list(Order))
def test_products_in_bfloat16_change_values_and_gradients_by_a_rounding(order: Order) -> None:
    """Its eight bits are one part in 256; three layers and a sum over all points keep to 2 %."""
    field = MetricPhaseField(width=64, omega=12.0, generator=torch.Generator().manual_seed(3))
    x = points(400).float()
    found = []
    for precision in (None, torch.bfloat16):
        field.siren.precision = precision
        fields = field(x, order)
        jets = [j for j in (fields.r, fields.theta) for j in (j.value, j.gradient, j.laplacian)]
        carried = [j for j in jets if j is not None]
        loss = torch.stack([(j * j.detach().cos()).mean() for j in carried]).sum()
        slopes = torch.autograd.grad(loss, [*field.siren.parameters()])
        found.append([*(j.detach() for j in carried), *slopes])
    for exact, rounded in zip(*found, strict=True):
        assert rounded.dtype is torch.float32
        assert not torch.equal(exact, rounded) or exact.numel() < 100
        assert (exact - rounded).norm() < 0.02 * exact.norm() + 1e-6
