"""The eight terms on fields whose values, gradients and Laplacians are known in closed form."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from mpf_core.field import FieldJets, Jet
from mpf_core.field.metric_phase import phase_indicator
from mpf_core.fit import losses

BETA = torch.tensor(50.0, dtype=torch.float64)
# What a unit gradient loses of its length as a direction: directions are softened near zero.
SOFTENED = 1 / math.sqrt(1 + losses.SOFT**2)


def points(count: int = 400, seed: int = 0) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(count, 3, dtype=torch.float64, generator=generator) * 2 - 1


def on_sphere(radius: float, count: int = 400) -> Tensor:
    x = points(count)
    return radius * x / x.norm(dim=1, keepdim=True)


def signed(x: Tensor, radius: float = 0.5) -> Jet:
    """The exact signed distance of a sphere: Δ = 2/|x|."""
    length = x.norm(dim=1)
    return Jet(length - radius, x / length[:, None], 2 / length)


def unsigned(x: Tensor, radius: float = 0.5) -> Jet:
    """The exact unsigned distance, off the sphere."""
    d = signed(x, radius)
    sign = torch.sign(d.value)
    assert d.gradient is not None and d.laplacian is not None
    return Jet(sign * d.value, sign[:, None] * d.gradient, sign * d.laplacian)


def flipped(jet: Jet) -> Jet:
    assert jet.gradient is not None
    return Jet(-jet.value, -jet.gradient, None if jet.laplacian is None else -jet.laplacian)


def scaled(jet: Jet, by: float) -> Jet:
    assert jet.gradient is not None and jet.laplacian is not None
    return Jet(by * jet.value, by * jet.gradient, by * jet.laplacian)


def fields(r: Jet, theta: Jet) -> FieldJets:
    p = phase_indicator(theta, BETA)
    return FieldJets(r, theta, p, r * p + theta)


def sphere_fields(x: Tensor) -> FieldJets:
    return fields(unsigned(x), signed(x))


def test_zero_level_vanishes_on_the_surface_and_measures_r_plus_phi_off_it() -> None:
    assert losses.zero_loss(sphere_fields(on_sphere(0.5))).item() == pytest.approx(0, abs=1e-12)
    # At distance 0.2, r = θ = 0.2 and P is 1 but for 1e-8: r + |φ| = 3 · 0.2.
    for radius in (0.3, 0.7):
        value = losses.zero_loss(sphere_fields(on_sphere(radius))).item()
        assert value == pytest.approx(0.6, rel=1e-6)


def test_zero_level_is_blind_to_orientation() -> None:
    x = points()
    turned = fields(unsigned(x), flipped(signed(x)))
    assert losses.zero_loss(turned).item() == pytest.approx(
        losses.zero_loss(sphere_fields(x)).item()
    )


def test_align_wants_parallel_gradients_and_is_blind_to_orientation() -> None:
    x = on_sphere(0.5001)
    r, theta = unsigned(x), signed(x)
    least = math.exp(-100 * 0.0001) * (1 - SOFTENED**2)
    assert losses.align_loss(r, theta, 100).item() == pytest.approx(least)
    assert losses.align_loss(r, flipped(theta), 100).item() == pytest.approx(least)


def test_align_is_greatest_for_gradients_at_right_angles() -> None:
    zero, n = torch.zeros(5, dtype=torch.float64), 5
    along_x = Jet(zero, torch.eye(3, dtype=torch.float64)[:1].expand(n, 3))
    along_y = Jet(zero, torch.eye(3, dtype=torch.float64)[1:2].expand(n, 3))
    assert losses.align_loss(along_x, along_y, 100).item() == 1


def test_align_counts_in_the_band_alone() -> None:
    zero = torch.zeros(3, dtype=torch.float64)
    axes = torch.eye(3, dtype=torch.float64)
    theta = Jet(zero, axes[1:2].expand(3, 3))
    for r in (0.0, 0.01, 0.1):
        metric = Jet(zero + r, axes[:1].expand(3, 3))
        assert losses.align_loss(metric, theta, 100).item() == pytest.approx(math.exp(-100 * r))


def test_align_counts_less_where_theta_folds() -> None:
    zero = torch.zeros(3, dtype=torch.float64)
    axes = torch.eye(3, dtype=torch.float64)
    metric = Jet(zero, axes[:1].expand(3, 3))
    oblique = 0.6 * axes[:1] + 0.8 * axes[1:2]
    for length, share in ((2.0, 1.0), (1.0, 1.0), (0.5, 0.25), (0.0, 0.0)):
        slope = (length * oblique.expand(3, 3)).requires_grad_()
        term = losses.align_loss(metric, Jet(zero, slope), 100, torch.ones(3))
        (found,) = torch.autograd.grad(term, slope)
        full = losses.align_loss(metric, Jet(zero, slope), 100, torch.zeros(3))
        (whole,) = torch.autograd.grad(full, slope)
        assert term.item() == pytest.approx(share * full.item())
        assert (whole.norm() > 0) == (length > 0)
        assert torch.allclose(found, share * whole)  # the weight itself pulls at nothing


def test_metric_eikonal_measures_the_length_of_the_gradient_of_r() -> None:
    r = unsigned(points())
    assert losses.metric_eikonal_loss(r).item() == pytest.approx(0, abs=1e-12)
    assert losses.metric_eikonal_loss(scaled(r, 1.5)).item() == pytest.approx(0.5)
    assert losses.metric_eikonal_loss(scaled(r, 0.25)).item() == pytest.approx(0.75)


def test_interface_eikonal_holds_at_the_samples_where_both_gradients_agree() -> None:
    """Proposition 2 lets one sphere satisfy both summands."""
    sphere = sphere_fields(on_sphere(0.5))
    assert losses.interface_eikonal_loss(sphere.phi, sphere.theta).item() == pytest.approx(
        0, abs=1e-9
    )
    theta = signed(on_sphere(0.5))
    assert losses.interface_eikonal_loss(scaled(theta, 3), scaled(theta, 0.5)).item() == (
        pytest.approx(2.5)
    )


def test_laplacian_is_that_of_the_field() -> None:
    x = on_sphere(0.8)
    assert losses.laplacian_loss(signed(x)).item() == pytest.approx(2 / 0.8)
    flat = Jet(x[:, 0], torch.ones_like(x), torch.zeros(len(x), dtype=torch.float64))
    assert losses.laplacian_loss(flat).item() == 0
    assert losses.laplacian_loss(flipped(signed(x))).item() == pytest.approx(2 / 0.8)


def test_phase_is_zero_where_saturated_and_one_where_undecided() -> None:
    for value, expected in ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.5, 0.25), (-0.5, 0.25)):
        p = Jet(torch.full((4,), value))
        assert losses.phase_loss(p).item() == pytest.approx(expected)


def test_phase_with_known_sides_charges_the_wrong_side() -> None:
    p = Jet(torch.tensor([1.0, -1.0, -1.0, 0.5]))
    side = torch.tensor([1.0, -1.0, 1.0, 0.0])
    assert losses.phase_loss(p, side).item() == pytest.approx((0 + 0 + 4 + 0.25) / 4)
    unknown = torch.zeros(4)
    assert losses.phase_loss(p, unknown).item() == pytest.approx(losses.phase_loss(p).item())


def test_far_field_fades_with_the_distance() -> None:
    near, far = (losses.far_loss(sphere_fields(on_sphere(r)), 100) for r in (0.51, 0.9))
    assert far.item() == pytest.approx(math.exp(-100 * 1.2), rel=1e-3)
    # At 0.01: r + |φ| = 0.01 + 0.01·tanh(0.5) + 0.01.
    assert near.item() == pytest.approx(math.exp(-(2 + math.tanh(0.5))))
    on = losses.far_loss(sphere_fields(on_sphere(0.5)), 100)
    assert on.item() == pytest.approx(1)


def test_normals_are_blind_to_orientation_unless_asked() -> None:
    x = on_sphere(0.5)
    phi, normals = signed(x), x / 0.5
    least = 1 - SOFTENED
    for sign in (1, -1):
        assert losses.normal_loss(phi, sign * normals).item() == pytest.approx(least)
        oriented = losses.normal_loss(phi, sign * normals, oriented=True).item()
        assert oriented == pytest.approx(1 - sign * SOFTENED)
    across = torch.linalg.cross(normals, torch.roll(normals, 1, dims=1))
    across = across / across.norm(dim=1, keepdim=True)
    assert losses.normal_loss(phi, across).item() == pytest.approx(1)


@pytest.mark.parametrize("oriented", [False, True])
@pytest.mark.parametrize("least", [0.0, 0.15])
def test_a_normals_length_is_its_weight(oriented: bool, least: float) -> None:
    x = on_sphere(0.5)
    length = torch.where(torch.arange(len(x)) % 2 == 0, 1.0, least)
    part = losses.normal_loss(signed(x), x / 0.5 * length[:, None], oriented=oriented).item()
    assert part == pytest.approx(length.mean().item() * (1 - SOFTENED), rel=1e-5)


def test_regression_vanishes_at_its_target_and_counts_less_far_away() -> None:
    x = points()
    jets = sphere_fields(x)
    theta, r = jets.theta.value, jets.r.value
    assert losses.regression_loss(jets, theta, r).item() == 0
    zero = torch.zeros(4, dtype=torch.float64)
    off = replace(jets, theta=Jet(zero + 0.1), r=Jet(zero + 0.1))
    assert losses.regression_loss(off, zero, zero).item() == pytest.approx(1.3)
    far = replace(jets, theta=Jet(zero + 0.4), r=Jet(zero + 0.4))
    at = zero + 0.3
    assert losses.regression_loss(far, at, at).item() == pytest.approx(1.3 / 11)


def test_regression_counts_what_is_on_the_wrong_side_in_full() -> None:
    jets = sphere_fields(points())
    at = torch.full((4,), 0.3, dtype=torch.float64)
    wrong = replace(jets, theta=Jet(at - 0.4), r=Jet(at))  # at -0.1, of a target of 0.3
    assert losses.regression_loss(wrong, at, at).item() == pytest.approx(10 * (0.3 / 11 + 0.1))
    assert losses.regression_loss(wrong, -at, at).item() == pytest.approx(10 * 0.2 / 11)


@pytest.mark.parametrize("shift", [0.0, 1e-9])
def test_every_term_has_finite_derivatives_at_its_kinks(shift: float) -> None:
    """Values and gradients of zero are where absolute values and norms have their corners."""
    value = torch.full((6,), shift, dtype=torch.float64, requires_grad=True)
    gradient = torch.full((6, 3), shift, dtype=torch.float64, requires_grad=True)
    laplacian = torch.full((6,), shift, dtype=torch.float64, requires_grad=True)
    jet = Jet(value, gradient, laplacian)
    all_of = FieldJets(jet, jet, jet, jet)
    normals = torch.eye(3, dtype=torch.float64).repeat(2, 1)
    total = (
        losses.zero_loss(all_of)
        + losses.align_loss(jet, jet, 100)
        + losses.metric_eikonal_loss(jet)
        + losses.interface_eikonal_loss(jet, jet)
        + losses.laplacian_loss(jet)
        + losses.phase_loss(jet)
        + losses.far_loss(all_of, 100)
        + losses.normal_loss(jet, normals)
    )
    total.backward()  # type: ignore[no-untyped-call]
    for leaf in (value, gradient, laplacian):
        assert leaf.grad is not None
        assert torch.isfinite(leaf.grad).all()


def test_terms_do_not_depend_on_how_many_points_are_drawn() -> None:
    x = points(100)
    once, thrice = sphere_fields(x), sphere_fields(x.repeat(3, 1))
    assert losses.zero_loss(thrice).item() == pytest.approx(losses.zero_loss(once).item())
    assert losses.laplacian_loss(thrice.theta).item() == pytest.approx(
        losses.laplacian_loss(once.theta).item()
    )
    assert losses.far_loss(thrice, 5).item() == pytest.approx(losses.far_loss(once, 5).item())


def test_missing_derivatives_are_named() -> None:
    bare = Jet(torch.zeros(3))
    with pytest.raises(ValueError, match="GRADIENT"):
        losses.metric_eikonal_loss(bare)
    with pytest.raises(ValueError, match="LAPLACIAN"):
        losses.laplacian_loss(bare)
