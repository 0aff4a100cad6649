"""The mean of a field's parameters over the last steps of a fit.

Steps of stochastic gradients leave the parameters wandering about what they should be, and the
surface with waves many spacings long. Their mean along the way wanders less (Polyak and Juditsky
1992), and costs one pass over them.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch
from torch import Tensor, nn

YOUNG = 10.0  # of n steps so far the mean forgets at most (1 + n)/(YOUNG + n) a step


class Averaging:
    """The exponential mean of a module's state, which keeps `share` of itself in each step."""

    def __init__(self, module: nn.Module, share: float):
        self.module, self.share, self.steps = module, share, 0
        self.mean: dict[str, Tensor] = {}

    @torch.no_grad()
    def add(self) -> None:
        """Take in the module as it is now."""
        now = self.module.state_dict()
        if not self.mean:
            self.mean = {name: value.clone() for name, value in now.items()}
        self.steps += 1
        kept = min(self.share, (1 + self.steps) / (YOUNG + self.steps))
        torch._foreach_lerp_(list(self.mean.values()), [now[name] for name in self.mean], 1 - kept)

    @contextmanager
    def shown(self) -> Iterator[dict[str, Tensor]]:
        """Within, the module is its mean, whose state this gives; as it is where there is none."""
        if not self.mean:
            yield self.module.state_dict()
            return
        now = {name: value.clone() for name, value in self.module.state_dict().items()}
        self.module.load_state_dict(self.mean)
        try:
            yield self.module.state_dict()
        finally:
            self.module.load_state_dict(now)

    def restore(self, mean: dict[str, Tensor], steps: int) -> None:
        """Go on from a mean of so many steps."""
        self.mean, self.steps = {name: value.clone() for name, value in mean.items()}, steps
