"""The fitted field as a file: `field.safetensors`, all that later extractions need.

Tensors are the network's weights (float32, by their names in `MetricPhaseField`), `samples` (m, 3)
uint16 and, where the cloud had colours, `colors` (m, 3) uint8. The header's only metadata entry is
one JSON text, so that equal fields make equal files. A file is judged by its header before any
tensor is read: it may come from anywhere.
"""

from __future__ import annotations

import json
import math
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from mpf_core.cloud.normalize import Similarity
from mpf_core.errors import FieldFormat, FieldVersion
from mpf_core.field.fitted import FittedField
from mpf_core.field.footprint import Footprint
from mpf_core.field.metric_phase import COMPOSITES, MetricPhaseField
from mpf_core.files import write_atomically

VERSION = 1
ENTRY = "metric-phase-field"
LARGEST_FILE = 32 * 2**20  # bytes: the widest network and a full footprint take half of it
LARGEST_WEIGHT = 1e6  # no honest fit comes near; beyond, single precision overflows in a layer
MOST_SAMPLES = 2**20

Shapes = dict[str, tuple[int, ...]]


def field_bytes(fitted: FittedField) -> bytes:
    """The file's content."""
    weights = {n: t.detach().cpu().numpy() for n, t in fitted.field.state_dict().items()}
    tensors: dict[str, NDArray[Any]] = weights | {"samples": fitted.footprint.lattice}
    if fitted.footprint.colors is not None:
        tensors["colors"] = fitted.footprint.colors
    text = json.dumps(_about(fitted), allow_nan=False)
    content: bytes = save(
        {name: np.array(tensors[name], order="C") for name in sorted(tensors)},
        metadata={ENTRY: text},
    )
    return content


def save_field(fitted: FittedField, path: str | Path) -> None:
    """Write the field to `path`, whole or not at all."""
    write_atomically(path, field_bytes(fitted))


def load_field(path: str | Path) -> FittedField:
    """The field that `save_field` wrote.

    Raises FieldFormat for anything else, FieldVersion for a file of later software, OSError.
    """
    path = Path(path)
    if not path.is_file():
        path.read_bytes()  # says why: missing, a folder, not permitted
    if (size := path.stat().st_size) > LARGEST_FILE:
        raise _wrong(f"the file has {size} bytes, more than any field")
    try:
        with safe_open(path, framework="np") as file:
            return _read(file)
    except SafetensorError as error:
        raise _wrong(f"it is not a safetensors file, or a damaged one: {error}") from error


def _about(fitted: FittedField) -> dict[str, Any]:
    field, similarity, footprint = fitted.field, fitted.similarity, fitted.footprint
    return {
        "version": VERSION,
        "software": f"metric-phase-fields {version('metric-phase-fields')}",
        "width": field.width,
        "omega": float(field.omega),
        "softplus_slope": float(field.softplus_slope),
        **({} if field.composite == COMPOSITES[0] else {"composite": field.composite}),
        "center": similarity.center.tolist(),
        "scale": float(similarity.scale),
        "box": fitted.box.tolist(),
        "cover": footprint.cover,
        "spacing": footprint.spacing,
        "reach": footprint.reach,
        "thickness": footprint.thickness,
    }


def _read(file: Any) -> FittedField:
    about = _metadata(file)
    width = _whole(about, "width", 8, 1024)
    with torch.device("meta"):  # shapes without memory
        field = MetricPhaseField(
            width=width,
            omega=_number(about, "omega", 1e-3, 1e6),
            softplus_slope=_number(about, "softplus_slope", 1e-3, 1e6),
            composite=_one_of(about, "composite", COMPOSITES),
        )
    similarity = Similarity(
        np.array(_numbers(about, "center", 3, 1e100)), _number(about, "scale", 1e-101, 1e101)
    )
    low, high = (np.array(row) for row in np.reshape(_numbers(about, "box", 6, 2.0), (2, 3)))
    if not (high - low >= 1e-3).all():
        raise _wrong("its box has no volume")
    lengths = {name: _number(about, name, 0.0, 4.0) for name in ("cover", "spacing", "reach")}
    if not (lengths["spacing"] > 0 and lengths["reach"] > 0):
        raise _wrong("its spacing is 0")
    thickness = None
    if about.get("thickness") is not None:
        thickness = _number(about, "thickness", 1e-6, 2.0)
    _check_tensors(file, {name: tuple(p.shape) for name, p in field.state_dict().items()})
    _fill(field, file)
    colors = file.get_tensor("colors") if "colors" in file.keys() else None  # noqa: SIM118
    footprint = Footprint(file.get_tensor("samples"), colors, **lengths, thickness=thickness)
    return FittedField(field, similarity, np.stack([low, high]), footprint)


def _metadata(file: Any) -> dict[str, Any]:
    try:
        about = json.loads((file.metadata() or {})[ENTRY])
    except (KeyError, ValueError, RecursionError) as error:
        raise _wrong("its header does not describe a field") from error
    if not isinstance(about, dict):
        raise _wrong("its header does not describe a field")
    if (found := _whole(about, "version", 1, 10**6)) > VERSION:
        raise FieldVersion(
            f"the field has format version {found}; this software reads {VERSION}",
            advice=f"Use newer software: it was written by {str(about.get('software'))[:80]!r}.",
        )
    return about


def _check_tensors(file: Any, weights: Shapes) -> None:
    """Names, types and shapes, from the header alone."""
    names = set(file.keys())
    if missing := (weights.keys() | {"samples"}) - names:
        raise _wrong(f"it lacks {sorted(missing)[0]}")
    if unknown := names - weights.keys() - {"samples", "colors"}:
        raise _wrong(f"it holds an unknown tensor {sorted(unknown)[0][:80]!r}")
    count = file.get_slice("samples").get_shape()[:1]
    if not count or not 1 <= count[0] <= MOST_SAMPLES:
        raise _wrong("it holds no samples, or too many")
    expected = {name: ("F32", shape) for name, shape in weights.items()}
    expected |= {"samples": ("U16", (count[0], 3)), "colors": ("U8", (count[0], 3))}
    for name in names:
        tensor = file.get_slice(name)
        found = tensor.get_dtype(), tuple(tensor.get_shape())
        if found != expected[name]:
            raise _wrong(f"{name} is {found[0]} {found[1]}, not {expected[name]}")


def _fill(field: MetricPhaseField, file: Any) -> None:
    weights = {}
    for name in field.state_dict():
        values: NDArray[np.float32] = file.get_tensor(name)
        if not (np.abs(values) <= LARGEST_WEIGHT).all():  # false for NaN as well
            raise _wrong(f"{name} holds values that are not finite, or absurd")
        weights[name] = torch.from_numpy(np.array(values))  # one's own memory, aligned
    field.load_state_dict(weights, assign=True)
    field.requires_grad_(False)


def _whole(about: dict[str, Any], name: str, low: int, high: int) -> int:
    value = about.get(name)
    if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
        raise _wrong(f"its {name} is {str(value)[:80]!r}")
    return value


def _one_of(about: dict[str, Any], name: str, choices: tuple[str, ...]) -> str:
    """One of `choices`, the first where nothing is said."""
    value = about.get(name, choices[0])
    if value not in choices:
        raise _wrong(f"its {name} is {str(value)[:80]!r}")
    return str(value)


def _number(about: dict[str, Any], name: str, low: float, high: float) -> float:
    value = about.get(name)
    if (
        isinstance(value, bool)
        or not isinstance(value, int | float)
        or not low <= value <= high  # false for NaN as well
    ):
        raise _wrong(f"its {name} is {str(value)[:80]!r}")
    return float(value)


def _numbers(about: dict[str, Any], name: str, count: int, bound: float) -> list[float]:
    """`count` numbers within ± bound, from a list or a list of lists."""
    values = about.get(name)
    flat = values if isinstance(values, list) else []
    if flat and isinstance(flat[0], list):
        flat = [v for row in flat if isinstance(row, list) for v in row]
    good = [
        float(v)
        for v in flat
        if isinstance(v, int | float) and not isinstance(v, bool) and abs(v) <= bound
    ]
    if len(good) != count or len(flat) != count or not all(map(math.isfinite, good)):
        raise _wrong(f"its {name} is not {count} numbers in range")
    return good


def _wrong(what: str) -> FieldFormat:
    return FieldFormat(
        f"this is not a field that can be used: {what}",
        advice="Give a field.safetensors as `mpf reconstruct --field` writes it.",
    )
