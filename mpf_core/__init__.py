"""Metric-Phase Fields: surfaces from raw, unoriented point clouds.

`reconstruct(points, options)` is the whole library; `options_from({"preset": "draft"})` makes its
options. `save_field` keeps the `fitted` field of a reconstruction, for `load_field`, `extract` and
`slice_png`. Importing this package does not load torch; calling any of these does.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from mpf_core.options import Options, options_from

if TYPE_CHECKING:
    from mpf_core.field.blendfile import load_field, save_field
    from mpf_core.pipeline import Reconstruction, reconstruct
    from mpf_core.reuse import extract, slice_png

__all__ = [
    "Options",
    "Reconstruction",
    "extract",
    "load_field",
    "options_from",
    "reconstruct",
    "save_field",
    "slice_png",
]

# What loads torch, and where it is.
_LATE = {
    "Reconstruction": "pipeline",
    "reconstruct": "pipeline",
    "extract": "reuse",
    "slice_png": "reuse",
    "load_field": "field.blendfile",
    "save_field": "field.blendfile",
}


def __getattr__(name: str) -> Any:
    if name in _LATE:
        return getattr(import_module(f"mpf_core.{_LATE[name]}"), name)
    raise AttributeError(name)
