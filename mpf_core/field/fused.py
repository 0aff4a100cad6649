"""The functions of `plain` over tensors, by compiled loops: one pass over memory for each.

Importing this loads the compiler (numba), which may not be there; `pointwise` decides.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import torch
from numba import types
from torch import Tensor

from mpf_core.field import kernels

NAME = "fused"

_NOT_ARRAYS = {"0": types.none, "i": types.int64}
_ENTRIES = {"K": types.float32, "F": types.float32, "D": types.float64, "I": types.int64}

# Types of the arguments: K kept, F float32, with the number of dimensions; 0 left out.
FORMS: dict[str, tuple[str, ...]] = {
    "first": ("K2 K2 F2 F2 F1",),
    "layer": ("K2 K2 F1",),
    "output": ("F2 K3 K3 F2 F2",),
    "layer_back": ("K2 F1 K2 K2 0", "K2 F1 K2 K2 K2"),
    "first_back": ("K2 F2 F1 K2 K2 0 F2", "K2 F2 F1 K2 K2 K2 F2"),
    "output_back": ("K3 F2 F2 K3 0 F2 F2", "K3 F2 F2 K3 K3 F2 F2"),
    "times": ("K3 K3 K2",),
    "times_back": ("K3 K2 K3 K2",),
    "slopes": ("F3 K3 K2 F2",),
    "slopes_back": ("K3 K2 F2 K2 F2 F3",),
    "bent": ("K3 K3 K2 K2",),
    "bent_back": ("K3 K2 F1 K3 K2 K2",),
    "bent_first": ("K3 F2 K2 K2",),
    "bent_first_back": ("K2 F2 F1 K3 F2 K2 K2 F2",),
    "bent_output": ("F3 K4 K3 K3 F2",),
    "bent_output_back": ("K4 K3 F2 F2 K3 F2 F2 F3",),
}
OF_THETA: dict[str, tuple[str, ...]] = {
    "first_sine": ("F2 F2 F2 F1",),
    "sine": ("F2 F1",),
    "sine_output": ("F1 F2 F1 F1",),
}


def compilations(kept: torch.dtype | None) -> Iterator[Callable[[], None]]:
    """What compiles, one after another, all that the sweeps of a fit with arrays kept in that
    type call, or all that θ alone takes."""
    for name, forms in (OF_THETA if kept is None else FORMS).items():
        for form in forms:
            yield compilation(getattr(kernels, name), form, kept)


def compilation(kernel: Any, form: str, kept: torch.dtype | None) -> Callable[[], None]:
    """What compiles a loop for arguments of that form (see FORMS; D float64, I int64,
    i an integer)."""

    def of(code: str) -> Any:
        if code in _NOT_ARRAYS:
            return _NOT_ARRAYS[code]
        narrow = code[0] == "K" and kept is torch.bfloat16
        entry = types.uint16 if narrow else _ENTRIES[code[0]]
        return types.Array(entry, int(code[1]), "C")

    types_of = tuple(of(code) for code in form.split())

    def run() -> None:
        try:
            kernel.compile(types_of)
        except Exception:  # of the cache's own: the compiler writes without syncing, and a power
            # cut may leave files of its names that are empty
            _forget(kernel)
            kernel.compile(types_of)

    return run


def _forget(kernel: Any) -> None:
    """Remove what the cache holds of a loop; raises OSError."""
    if kernel.stats.cache_path is not None:
        for path in Path(kernel.stats.cache_path).glob(f"*.{kernel.__name__}-*.nb[ci]"):
            path.unlink(missing_ok=True)


def _over_tensors(name: str) -> Callable[..., None]:
    kernel = getattr(kernels, name)

    def run(*arguments: Tensor | None) -> None:
        kernel(*[array_of(a) for a in arguments])

    return run


def array_of(a: Tensor | None) -> Any:
    """The tensor's memory as numpy sees it."""
    if a is None:
        return None
    if a.dtype is torch.bfloat16:
        a = a.view(torch.uint16)
    return a.numpy()


first = _over_tensors("first")
layer = _over_tensors("layer")
output = _over_tensors("output")
layer_back = _over_tensors("layer_back")
first_back = _over_tensors("first_back")
output_back = _over_tensors("output_back")
times = _over_tensors("times")
times_back = _over_tensors("times_back")
slopes = _over_tensors("slopes")
slopes_back = _over_tensors("slopes_back")
bent = _over_tensors("bent")
bent_back = _over_tensors("bent_back")
bent_first = _over_tensors("bent_first")
bent_first_back = _over_tensors("bent_first_back")
bent_output = _over_tensors("bent_output")
bent_output_back = _over_tensors("bent_output_back")
first_sine = _over_tensors("first_sine")
sine = _over_tensors("sine")
sine_output = _over_tensors("sine_output")
