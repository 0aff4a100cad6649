"""What files of fields share: strict reading of their headers, frames, boxes and samples.

A file is judged by its header before any tensor is read: it may come from anywhere.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from mpf_core.cloud.normalize import Similarity
from mpf_core.errors import FieldFormat, FieldVersion
from mpf_core.field.footprint import Footprint

MOST_SAMPLES = 2**20

T = TypeVar("T")
Found = dict[str, tuple[str, tuple[int, ...]]]  # by tensor: its type and its shape


def packed(entry: str, about: dict[str, Any], tensors: dict[str, NDArray[Any]]) -> bytes:
    """The file's content. The header's only metadata entry is one JSON text, so that equal fields
    make equal files."""
    content: bytes = save(
        {name: np.array(tensors[name], order="C") for name in sorted(tensors)},
        metadata={entry: json.dumps(about, allow_nan=False)},
    )
    return content


def opened(path: Path, largest: int, read: Callable[[Any], T]) -> T:
    """What `read` makes of the safetensors file at `path` of at most `largest` bytes.

    Raises FieldFormat for any other file, OSError.
    """
    if not path.is_file():
        path.read_bytes()  # says why: missing, a folder, not permitted
    if (size := path.stat().st_size) > largest:
        raise wrong(f"the file has {size} bytes, more than any field")
    try:
        with safe_open(path, framework="np") as file:
            return read(file)
    except SafetensorError as error:
        raise wrong(f"it is not a safetensors file, or a damaged one: {error}") from error


def signature(number_of_format: int) -> dict[str, Any]:
    """The format's version and who wrote the file."""
    software = f"metric-phase-fields {version('metric-phase-fields')}"
    return {"version": number_of_format, "software": software}


def described(file: Any, entry: str, newest: int) -> dict[str, Any]:
    """The header's JSON object; raises FieldVersion where it is later than `newest`."""
    try:
        about = json.loads((file.metadata() or {})[entry])
    except (KeyError, ValueError, RecursionError) as error:
        raise wrong("its header does not describe a field") from error
    if not isinstance(about, dict):
        raise wrong("its header does not describe a field")
    if (found := whole(about, "version", 1, 10**6)) > newest:
        raise FieldVersion(
            f"the field has format version {found}; this software reads {newest}",
            advice=f"Use newer software: it was written by {str(about.get('software'))[:80]!r}.",
        )
    return about


def frame_of(similarity: Similarity) -> dict[str, Any]:
    """A frame as the header holds it."""
    return {"center": similarity.center.tolist(), "scale": float(similarity.scale)}


def frame_in(about: dict[str, Any]) -> Similarity:
    """The frame that a header holds."""
    center = np.array(numbers(about, "center", 3, 1e100))
    return Similarity(center, number(about, "scale", 1e-101, 1e101))


def box_in(about: dict[str, Any]) -> NDArray[np.float64]:
    """(2, 3) the box that a header holds."""
    box = np.reshape(numbers(about, "box", 6, 2.0), (2, 3))
    if not (box[1] - box[0] >= 1e-3).all():
        raise wrong("its box has no volume")
    return box


def lengths_of(footprint: Footprint) -> dict[str, Any]:
    """The footprint's lengths as the header holds them."""
    names = ("cover", "spacing", "reach", "thickness")
    return {name: getattr(footprint, name) for name in names}


def lengths_in(about: dict[str, Any]) -> dict[str, Any]:
    """The footprint's lengths that a header holds."""
    lengths: dict[str, Any] = {
        name: number(about, name, 0.0, 4.0) for name in ("cover", "spacing", "reach")
    }
    if not (lengths["spacing"] > 0 and lengths["reach"] > 0):
        raise wrong("its spacing is 0")
    thin = about.get("thickness")
    lengths["thickness"] = None if thin is None else number(about, "thickness", 1e-6, 2.0)
    return lengths


def samples_of(footprint: Footprint) -> dict[str, NDArray[Any]]:
    """The tensors of a footprint."""
    tensors: dict[str, NDArray[Any]] = {"samples": footprint.lattice}
    return tensors if footprint.colors is None else tensors | {"colors": footprint.colors}


def samples_in(file: Any) -> tuple[str, tuple[int, ...]]:
    """Type and shape of the samples, of which there are not too many."""
    if "samples" not in file.keys():  # noqa: SIM118
        raise wrong("it lacks samples")
    count = file.get_slice("samples").get_shape()[:1]
    if not count or not 1 <= count[0] <= MOST_SAMPLES:
        raise wrong("it holds no samples, or too many")
    return "U16", (count[0], 3)


def colors_in(file: Any) -> Found:
    """The colours that may be there: one for each sample."""
    return {"colors": ("U8", samples_in(file)[1])}


def footprint_in(file: Any, lengths: dict[str, Any]) -> Footprint:
    """The footprint, from tensors that were checked."""
    colors = file.get_tensor("colors") if "colors" in file.keys() else None  # noqa: SIM118
    return Footprint(file.get_tensor("samples"), colors, **lengths)


def whole(about: dict[str, Any], name: str, low: int, high: int) -> int:
    """A whole number from `low` to `high`."""
    value = about.get(name)
    if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
        raise wrong(f"its {name} is {str(value)[:80]!r}")
    return value


def one_of(about: dict[str, Any], name: str, choices: tuple[str, ...]) -> str:
    """One of `choices`, the first where nothing is said."""
    value = about.get(name, choices[0])
    if value not in choices:
        raise wrong(f"its {name} is {str(value)[:80]!r}")
    return str(value)


def number(about: dict[str, Any], name: str, low: float, high: float) -> float:
    """A number from `low` to `high`."""
    value = about.get(name)
    if (
        isinstance(value, bool)
        or not isinstance(value, int | float)
        or not low <= value <= high  # false for NaN as well
    ):
        raise wrong(f"its {name} is {str(value)[:80]!r}")
    return float(value)


def numbers(about: dict[str, Any], name: str, count: int, bound: float) -> list[float]:
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
        raise wrong(f"its {name} is not {count} numbers in range")
    return good


def wrong(what: str) -> FieldFormat:
    """The error for a file that is not what it claims to be."""
    return FieldFormat(
        f"this is not a field that can be used: {what}",
        advice="Give a field.safetensors as `mpf reconstruct --field` writes it.",
    )
