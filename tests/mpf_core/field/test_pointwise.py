"""The compiled loops against their definitions, and what happens where they cannot be compiled."""

from __future__ import annotations

import inspect
import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from torch import Tensor

from mpf_core import field as field_package
from mpf_core.errors import Cancelled
from mpf_core.field import MetricPhaseField, Order, fused, plain, pointwise
from mpf_core.field.network import LARGEST_WEIGHT, LARGEST_WIDTH
from mpf_core.field.siren import Siren
from mpf_core.field.sweeps import GradientSweep
from mpf_core.parallel import workers

N, H = 7, 37  # no multiples of what a vector holds
LARGEST = 800.0  # of |z|: first layers come to ±150 where ω₀ = 45


def random(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed))


def sines(z: Tensor) -> tuple[Tensor, Tensor]:
    s, c = torch.empty_like(z), z.clone()
    fused.layer(s, c, torch.zeros(z.shape[1]))
    return s, c


@pytest.mark.parametrize("largest", [1.0, 10.0, 150.0, LARGEST])
def test_sines_and_cosines_are_off_by_less_than_a_millionth(largest: float) -> None:
    generator = torch.Generator().manual_seed(int(largest))
    spread = (torch.rand(4000, 256, generator=generator) * 2 - 1) * largest
    quarters = torch.arange(-512, 512).float() * (torch.pi / 2)  # where signs and branches change
    for z in (spread, torch.stack([quarters, quarters.nextafter(torch.tensor(torch.inf))])):
        s, c = sines(z)
        assert (s - z.double().sin()).abs().max() < 1e-6
        assert (c - z.double().cos()).abs().max() < 1e-6


def test_whatever_is_read_from_a_file_gets_sines() -> None:
    largest = (LARGEST_WIDTH + 1) * LARGEST_WEIGHT
    generator = torch.Generator().manual_seed(0)
    s, c = sines((torch.rand(4000, 64, generator=generator) * 2 - 1) * largest)
    assert (s.double().square() + c.double().square() - 1).abs().max() < 1e-5


def test_what_is_not_a_number_stays_none() -> None:
    """So that a fit which diverged is seen to."""
    s, c = sines(torch.tensor([[torch.nan, torch.inf, -torch.inf]]))
    assert not torch.isfinite(s).any() and not torch.isfinite(c).any()


def shape_of(name: str, function: str, form: str) -> tuple[int, ...]:
    if name in ("x", "y", "y_bar"):
        return (N, 3) if name == "x" else (2, N)
    if name in ("w", "w_sum"):
        return 3, H
    if name in ("g", "g_bar"):
        return 2, N, 3
    if form.startswith("F"):  # a bias, an output weight, their sums; what leaves `bent_output`
        return {"F1": (H,), "F2": (2, H), "F3": (2, N, 4)}[form]
    if form == "K3":
        return (N, 4, H) if name in ("d", "q", "d_bar") else (N, 2, H)
    return {"K2": (N, H), "K4": (N, 4, 2, H)}[form]


CASES = [(name, form) for name, forms in fused.FORMS.items() for form in forms]


@pytest.mark.parametrize("kept", [torch.float32, torch.bfloat16])
@pytest.mark.parametrize(("function", "form"), CASES)
def test_a_loop_does_what_its_definition_says(function: str, form: str, kept: torch.dtype) -> None:
    names = inspect.signature(getattr(plain, function)).parameters
    arguments: list[Tensor | None] = []
    for seed, (name, code) in enumerate(zip(names, form.split(), strict=True)):
        made = None if code == "0" else random(*shape_of(name, function, code), seed=seed)
        narrow = made is not None and code.startswith("K")
        arguments.append(made.to(kept) if narrow and made is not None else made)
    before = [None if a is None else a.clone() for a in arguments]
    expected = [None if a is None else a.clone() for a in arguments]
    pointwise.functions(kept)
    getattr(plain, function)(*expected)
    getattr(fused, function)(*arguments)
    changed = 0
    for found, wanted, old in zip(arguments, expected, before, strict=True):
        if found is None or wanted is None or old is None:
            continue
        changed += not torch.equal(found, old)
        # A last bit may round the other way; in bfloat16 that is one part in 128.
        step = 2**-7 if found.dtype is torch.bfloat16 else 2**-18
        scale = 1 + wanted.float().abs()
        assert ((found.float() - wanted.float()).abs() / scale).max() < step
    assert changed


@pytest.mark.parametrize("order", list(Order))
@pytest.mark.parametrize("threads", [1, 2])
def test_derivatives_agree_with_those_in_double_precision(order: Order, threads: int) -> None:
    field = MetricPhaseField(width=48, omega=12.0, generator=torch.Generator().manual_seed(3))
    x = (random(700, 3, seed=1) / 3).requires_grad_()

    def slopes(of: MetricPhaseField, at: Tensor) -> list[Tensor]:
        fields = of(at, order)
        jets = [j for f in (fields.r, fields.theta) for j in (f.value, f.gradient, f.laplacian)]
        carried = [j for j in jets if j is not None]
        loss = torch.stack([(j * j.detach().cos()).mean() for j in carried]).sum()
        return [*carried, *torch.autograd.grad(loss, [at, *of.siren.parameters()])]

    with workers(threads):
        found = slopes(field, x)
        with pointwise.uncompiled():
            plainly = slopes(field, x)
            exact = slopes(field.double(), x.detach().double().requires_grad_())
    for one, other, reference in zip(found, plainly, exact, strict=True):
        off, off_plainly = ((a - reference).norm().item() for a in (one, other))
        # The losses bend where a Laplacian passes a multiple of 2π: both paths share that.
        assert off <= 4 * off_plainly + 1e-5 * reference.norm().item()


def test_theta_alone_agrees_with_double_precision() -> None:
    net = Siren(96, 45.0, torch.Generator().manual_seed(0))
    x = random(500, 3)
    with torch.inference_mode():
        assert pointwise.functions_of_theta() is fused
        found = net.phase_value(x)
        assert (found - net.double().phase_value(x.double())).abs().max() < 2e-5


def test_a_sweep_goes_back_once() -> None:
    parameters = Siren(16, 12.0)._parameters_of_sweeps()
    y, g = GradientSweep.apply(random(40, 3), None, *parameters)  # type: ignore[no-untyped-call]
    loss = y.sum() + g.sum()
    loss.backward(retain_graph=True)
    with pytest.raises(RuntimeError, match="once"):
        loss.backward()


def test_without_the_compiler_all_is_plain_and_said_to_be(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mpf_core.field.fused", None)
    monkeypatch.delattr(field_package, "fused")
    choice = pointwise.Choice()
    assert choice.functions(torch.float32, None) is plain
    assert choice.functions_of_theta(None) is plain
    assert choice.reason is not None and "fused" in choice.reason


def test_compiling_is_given_up_at_once_and_can_be_taken_up_again() -> None:
    choice = pointwise.Choice()
    asked = 0

    def cancel() -> bool:
        nonlocal asked
        asked += 1
        return asked == 3

    with pytest.raises(Cancelled):
        choice.functions(torch.float32, cancel)
    assert asked == 3 and choice.reason is None
    assert choice.functions(torch.float32, None) is fused


COMPILE = "from mpf_core.field.pointwise import *; assert functions_of_theta().NAME == 'fused'"


def compiled_in_a_process(cache: Path) -> None:
    environment = os.environ | {"NUMBA_CACHE_DIR": str(cache)}
    subprocess.run([sys.executable, "-c", COMPILE], env=environment, check=True)


def test_what_one_process_compiles_the_next_finds(tmp_path: Path) -> None:
    compiled_in_a_process(tmp_path)
    kept = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.nb*")}
    assert len(kept) >= 2 * len(fused.OF_THETA)  # an index and the code of each
    compiled_in_a_process(tmp_path)
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.nb*")} == kept


def test_a_cache_that_a_power_cut_damaged_is_made_again(tmp_path: Path) -> None:
    compiled_in_a_process(tmp_path)
    damaged = [
        *tmp_path.rglob("kernels.sine-*.nbi"),
        *tmp_path.rglob("kernels.first_sine-*.nbc"),
    ]
    assert len(damaged) == 2
    for path in damaged:
        path.write_bytes(b"")
    compiled_in_a_process(tmp_path)
    assert all(path.stat().st_size > 0 for path in damaged)


def test_a_cache_that_cannot_be_written_does_not_matter(tmp_path: Path) -> None:
    compiled_in_a_process(Path("/proc/no-such-folder"))
