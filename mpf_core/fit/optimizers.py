"""Adam for vectors and β, Muon for the square matrices."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from mpf_core.field import MetricPhaseField
from mpf_core.fit_options import FitOptions
from mpf_core.parallel import shared

# Odd quintics whose composition brings singular values from [0.015, 1] to within 0.16 of 1, each
# the one with the least maximal error on what the one before leaves (Amsel et al. 2025), with their
# margin of 2 % for roundings. Jordan et al. 2024 take five equal rounds.
QUINTICS = (
    (7.7428, -21.5311, 15.2461),
    (3.3400, -2.4067, 0.4687),
    (2.3363, -1.6414, 0.3865),
)
TINY = 1e-12  # keeps a gradient of zero from being divided by zero


class Muon:
    """Momentum whose update is orthogonalised: all directions of a matrix learn equally fast."""

    def __init__(
        self,
        matrices: list[nn.Parameter],
        momentum: float = 0.95,
        precision: torch.dtype = torch.float32,
    ):
        self.matrices, self.momentum, self.precision = matrices, momentum, precision
        self.buffer = torch.stack([torch.zeros_like(m) for m in matrices])

    @torch.no_grad()
    def step(self, rate: float) -> None:
        gradient, share = self._gradient(), self.momentum
        torch.add(gradient, self.buffer, alpha=share, out=self.buffer)
        update = self.update(gradient.add_(self.buffer, alpha=share))
        for matrix, change in zip(self.matrices, update, strict=True):
            matrix.add_(change, alpha=-rate)

    @torch.no_grad()
    def rehearse(self) -> None:
        """The work of a step without its effect."""
        self.update(self._gradient())

    def update(self, direction: Tensor) -> Tensor:
        """Each of the matrices (m, h, h) orthogonalised."""
        parts = shared(lambda part: self._orthogonalise(direction[part]), len(direction))
        return torch.cat(parts)

    def _gradient(self) -> Tensor:
        return torch.stack([m.grad for m in self.matrices if m.grad is not None])

    def _orthogonalise(self, update: Tensor) -> Tensor:
        return orthogonal((update / _norms(update)).to(self.precision)).to(update.dtype)


def orthogonal(x: Tensor) -> Tensor:
    """Matrices (m, h, h) of norm 1 with all their singular values brought close to 1.

    ‖x·xᵀ‖^½, which is what each is scaled by, bounds them far more closely than ‖x‖ does.
    """
    gram = x @ x.mT
    scale = _norms(gram.float()).sqrt()
    x, gram = x / scale.to(x.dtype), gram / scale.square().to(x.dtype)
    for number, (a, b, c) in enumerate(QUINTICS):
        if number:
            gram = x @ x.mT
        polynomial = torch.baddbmm(gram, gram, gram, beta=b, alpha=c)
        x = torch.baddbmm(x, polynomial, x, beta=a)
    return x


def _norms(matrices: Tensor) -> Tensor:
    """(m, 1, 1), none of them 0."""
    squared: Tensor = matrices.square().sum((1, 2), keepdim=True)
    return squared.sqrt() + TINY


class Adam:
    """Kingma and Ba 2015. Torch's own loads its compiler, which takes seconds, to make no use of
    it."""

    EPSILON = 1e-8

    def __init__(self, parameters: list[nn.Parameter], betas: tuple[float, float]):
        self.parameters, self.betas = parameters, betas
        self.steps = [0] * len(parameters)  # of each: one may join later, as β does
        self.first = [torch.zeros_like(p) for p in parameters]
        self.second = [torch.zeros_like(p) for p in parameters]

    @torch.no_grad()
    def step(self, rates: list[float]) -> None:
        """One step of all that have a gradient, each at its own of `rates`."""
        keep, keep_square = self.betas
        state = zip(self.parameters, self.first, self.second, rates, strict=True)
        for k, (parameter, first, second, rate) in enumerate(state):
            gradient = parameter.grad
            if gradient is None:
                continue
            self.steps[k] += 1
            bias, bias_square = (1 - beta ** self.steps[k] for beta in self.betas)
            first.lerp_(gradient, 1 - keep)
            second.mul_(keep_square).addcmul_(gradient, gradient, value=1 - keep_square)
            root = (second / bias_square).sqrt_().add_(self.EPSILON)
            parameter.addcdiv_(first, root, value=-rate / bias)

    def state(self) -> dict[str, Tensor]:
        """Means and numbers of steps, copied."""
        tensors = {"steps": torch.tensor(self.steps)}
        for k, (first, second) in enumerate(zip(self.first, self.second, strict=True)):
            tensors |= {f"{k}.first": first.clone(), f"{k}.second": second.clone()}
        return tensors

    def restore(self, tensors: dict[str, Tensor]) -> None:
        """The inverse of `state`."""
        self.steps = [int(count) for count in tensors["steps"]]
        for k, (first, second) in enumerate(zip(self.first, self.second, strict=True)):
            first.copy_(tensors[f"{k}.first"])
            second.copy_(tensors[f"{k}.second"])


class Optimizer:
    """The optimisers of one fit as a single step."""

    def __init__(
        self,
        field: MetricPhaseField,
        options: FitOptions,
        precision: torch.dtype = torch.float32,
    ):
        self.options = options
        self.parameters = list(field.parameters())
        matrices = field.siren.square_matrices() if options.optimizer == "muon" else []
        self.muon = Muon(matrices, precision=precision) if matrices else None
        taken = {id(p) for p in [*matrices, field.beta]}
        self.rest = [p for p in self.parameters if id(p) not in taken]
        betas = (0.9, 0.99) if self.muon else (0.9, 0.999)
        self.adam = Adam([*self.rest, field.beta], betas)

    def step(self, rate: float) -> None:
        """Apply the gradients that stand in the parameters, at `rate` times the options' rates."""
        options = self.options
        if options.gradient_clip > 0:
            nn.utils.clip_grad_norm_(self.parameters, options.gradient_clip)
        rates = [options.learning_rate * rate] * len(self.rest)
        self.adam.step([*rates, options.beta_learning_rate])
        if self.muon:
            self.muon.step(options.muon_learning_rate * rate)

    def rehearse(self) -> None:
        """The work of a step without its effect, but for Adam's small part."""
        if self.muon:
            self.muon.rehearse()

    def zero_grad(self) -> None:
        for parameter in self.parameters:
            parameter.grad = None

    def state(self) -> dict[str, Tensor]:
        """Momenta and step counts, copied."""
        tensors = self.adam.state()
        if self.muon:
            tensors["momentum"] = self.muon.buffer.clone()
        return tensors

    def restore(self, tensors: dict[str, Tensor]) -> None:
        """The inverse of `state`."""
        self.adam.restore(tensors)
        if self.muon:
            self.muon.buffer.copy_(tensors["momentum"])
