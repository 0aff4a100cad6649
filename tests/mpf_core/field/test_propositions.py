"""The two propositions of the paper, as laws over random fields and points."""

from __future__ import annotations

import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from mpf_core.field import Jet, MetricPhaseField, Order
from mpf_core.field.metric_phase import phase_indicator

reals = st.floats(-5, 5, allow_nan=False, width=32)
positive = st.floats(0, 5, allow_nan=False, width=32)


def scalar(value: float) -> Tensor:
    return torch.tensor([value], dtype=torch.float64)


@given(r=positive, theta=reals, beta=st.floats(0.01, 500))
def test_phi_has_the_sign_of_theta(r: float, theta: float, beta: float) -> None:
    """Proposition 1: sign φ = sign θ, and φ = 0 exactly where θ = 0."""
    jet = Jet(scalar(theta))
    phi = Jet(scalar(r)) * phase_indicator(jet, torch.tensor(beta)) + jet
    assert torch.sign(phi.value) == torch.sign(jet.value)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000), omega=st.floats(5, 60), beta=st.floats(0.5, 200))
def test_a_network_of_any_weights_obeys_proposition_1(seed: int, omega: float, beta: float) -> None:
    generator = torch.Generator().manual_seed(seed)
    field = MetricPhaseField(width=16, omega=omega, beta=beta, generator=generator)
    jets = field(torch.rand(64, 3, generator=generator) * 2 - 1)
    assert (jets.r.value >= 0).all()
    assert (jets.indicator.value.abs() <= 1).all()
    assert torch.equal(torch.sign(jets.phi.value), torch.sign(jets.theta.value))


@given(
    beta=st.floats(0.01, 500),
    slope=st.tuples(reals, reals, reals),
    metric_slope=st.tuples(reals, reals, reals),
)
def test_gradients_agree_where_both_constraints_hold(
    beta: float, slope: tuple[float, ...], metric_slope: tuple[float, ...]
) -> None:
    """Proposition 2: r(p) = 0 and φ(p) = 0 imply ∇φ(p) = ∇θ(p), whatever ∇r(p)."""
    theta = Jet(scalar(0.0), torch.tensor([slope], dtype=torch.float64))
    r = Jet(scalar(0.0), torch.tensor([metric_slope], dtype=torch.float64))
    phi = r * phase_indicator(theta, torch.tensor(beta, dtype=torch.float64)) + theta
    assert torch.equal(phi.gradient, theta.gradient)


def test_closed_shapes_start_inside() -> None:
    field = MetricPhaseField(width=16, closed=True, generator=torch.Generator().manual_seed(0))
    assert field.siren.phase_offset < 0
    assert field(torch.zeros(1, 3), Order.VALUE).theta.value.shape == (1,)
