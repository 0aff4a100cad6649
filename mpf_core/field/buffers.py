"""Memory for the arrays of a step that the next step uses again.

A step takes some 60 MiB. Given back to the system, they would be mapped and cleared anew at every
step, which cost as much as the sines.
"""

from __future__ import annotations

import torch
from torch import Tensor


class Buffers:
    """Arrays by shape and type. What is not given back is freed like any other."""

    def __init__(self) -> None:
        self._idle: dict[tuple[tuple[int, ...], torch.dtype], list[Tensor]] = {}

    def take(self, shape: tuple[int, ...], dtype: torch.dtype) -> Tensor:
        """An array with anything in it, the one given back last if there is one."""
        try:  # another thread may take the last one between a look and a grasp
            return self._idle[shape, dtype].pop()
        except (KeyError, IndexError):
            return torch.empty(shape, dtype=dtype)

    def clear(self) -> None:
        """Free what is not in use."""
        self._idle.clear()

    def give(self, *arrays: Tensor) -> None:
        """Arrays that nobody looks at any more."""
        for array in arrays:
            self._idle.setdefault((tuple(array.shape), array.dtype), []).append(array)
