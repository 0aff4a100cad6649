"""A network in a safetensors file: its sizes in the header, its weights under a prefix."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from mpf_core.field.header import Found, number, one_of, whole, wrong
from mpf_core.field.metric_phase import COMPOSITES, MetricPhaseField

LARGEST_WIDTH = 1024
# No honest fit comes near. It keeps the arguments of sines, at most (width + 1) times as large,
# where compiled ones are still sines (`kernels._sincos`).
LARGEST_WEIGHT = 1e4


def sizes_of(field: MetricPhaseField) -> dict[str, Any]:
    """What the header tells of a network."""
    return {
        "width": field.width,
        "omega": float(field.omega),
        "softplus_slope": float(field.softplus_slope),
        **({} if field.composite == COMPOSITES[0] else {"composite": field.composite}),
    }


def weights_of(field: MetricPhaseField, prefix: str = "") -> dict[str, NDArray[Any]]:
    """Its tensors, float32."""
    state = field.state_dict()
    return {f"{prefix}{name}": tensor.detach().cpu().numpy() for name, tensor in state.items()}


def empty_network(about: dict[str, Any]) -> MetricPhaseField:
    """A network of the header's sizes: shapes without memory."""
    with torch.device("meta"):
        return MetricPhaseField(
            width=whole(about, "width", 8, LARGEST_WIDTH),
            omega=number(about, "omega", 1e-3, 1e6),
            softplus_slope=number(about, "softplus_slope", 1e-3, 1e6),
            composite=one_of(about, "composite", COMPOSITES),
        )


def tensors_of(field: MetricPhaseField, prefix: str = "") -> Found:
    """What a file must hold for this network."""
    return {f"{prefix}{n}": ("F32", tuple(p.shape)) for n, p in field.state_dict().items()}


def check_tensors(file: Any, needed: Found, allowed: Found) -> None:
    """Names, types and shapes, from the header alone."""
    names = set(file.keys())
    if missing := needed.keys() - names:
        raise wrong(f"it lacks {sorted(missing)[0]}")
    if unknown := names - needed.keys() - allowed.keys():
        raise wrong(f"it holds an unknown tensor {sorted(unknown)[0][:80]!r}")
    expected = needed | allowed
    for name in names:
        tensor = file.get_slice(name)
        found = tensor.get_dtype(), tuple(tensor.get_shape())
        if found != expected[name]:
            raise wrong(f"{name} is {found[0]} {found[1]}, not {expected[name]}")


def fill(field: MetricPhaseField, file: Any, prefix: str = "") -> None:
    """Read the weights of an empty network; they are not trained further."""
    weights = {}
    for name in field.state_dict():
        values: NDArray[np.float32] = file.get_tensor(f"{prefix}{name}")
        if not (np.abs(values) <= LARGEST_WEIGHT).all():  # false for NaN as well
            raise wrong(f"{prefix}{name} holds values that are not finite, or absurd")
        weights[name] = torch.from_numpy(np.array(values))  # one's own memory, aligned
    field.load_state_dict(weights, assign=True)
    field.requires_grad_(False)
