"""Adam for vectors and β, Muon for the square matrices, under one learning-rate schedule."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from mpf_core.field import MetricPhaseField
from mpf_core.options import FitOptions
from mpf_core.parallel import shared

# Quintic Newton–Schulz coefficients of Jordan et al. 2024: they push singular values to about 1
# in five products, without the last digits of an exact orthogonalisation.
QUINTIC = (3.4445, -4.7750, 2.0315)
WARM_UP = 20  # steps
LAST_RATE = 0.02  # of the first


class Muon:
    """Momentum whose update is orthogonalised: all directions of a matrix learn equally fast."""

    def __init__(self, matrices: list[nn.Parameter], momentum: float = 0.95, rounds: int = 5):
        self.matrices, self.momentum, self.rounds = matrices, momentum, rounds
        self.buffer = torch.stack([torch.zeros_like(m) for m in matrices])

    @torch.no_grad()
    def step(self, rate: float) -> None:
        gradient = torch.stack([m.grad for m in self.matrices if m.grad is not None])
        self.buffer.mul_(self.momentum).add_(gradient)
        direction = gradient + self.momentum * self.buffer
        update = torch.cat(shared(lambda part: self._orthogonalise(direction[part]), len(gradient)))
        for matrix, change in zip(self.matrices, update, strict=True):
            matrix.add_(change, alpha=-rate)

    def _orthogonalise(self, update: Tensor) -> Tensor:
        a, b, c = QUINTIC
        x: Tensor = update / (update.flatten(1).norm(dim=1)[:, None, None] + 1e-12)
        for _ in range(self.rounds):
            gram = x @ x.mT
            x = a * x + (b * gram + c * gram @ gram) @ x
        return x


class Optimizer:
    """The optimisers of one fit as a single step."""

    def __init__(self, field: MetricPhaseField, options: FitOptions, slowdown: float = 1.0):
        self.options, self.slowdown = options, slowdown
        self.parameters = list(field.parameters())
        matrices = field.siren.square_matrices() if options.optimizer == "muon" else []
        self.muon = Muon(matrices) if matrices else None
        taken = {id(p) for p in [*matrices, field.beta]}
        rest = [p for p in self.parameters if id(p) not in taken]
        betas = (0.9, 0.99) if self.muon else (0.9, 0.999)
        self.adam = torch.optim.Adam(
            [{"params": rest}, {"params": [field.beta]}], betas=betas, fused=True
        )

    def step(self, done: float, iteration: int) -> None:
        """Apply the gradients that stand in the parameters; `done` is the share of the fit."""
        options = self.options
        scale = self.slowdown * schedule(options.schedule, done, iteration)
        self.adam.param_groups[0]["lr"] = options.learning_rate * scale
        self.adam.param_groups[1]["lr"] = options.beta_learning_rate
        if options.gradient_clip > 0:
            nn.utils.clip_grad_norm_(self.parameters, options.gradient_clip)
        self.adam.step()
        if self.muon:
            self.muon.step(options.muon_learning_rate * scale)

    def zero_grad(self) -> None:
        for parameter in self.parameters:
            parameter.grad = None


def schedule(kind: str, done: float, iteration: int) -> float:
    """Factor on the learning rates."""
    if kind == "constant":
        return 1.0
    decay = max(0.5 * (1 + math.cos(math.pi * done)), LAST_RATE)
    return decay * min(1.0, iteration / WARM_UP + 0.05)
