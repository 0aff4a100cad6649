"""Metric-Phase Fields: surfaces from raw, unoriented point clouds.

`reconstruct(points, options)` is the whole library; `options_from({"preset": "draft"})` makes its
options. Importing this package does not load torch; calling `reconstruct` does.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mpf_core.options import Options, options_from

if TYPE_CHECKING:
    from mpf_core.pipeline import Reconstruction, reconstruct

__all__ = ["Options", "Reconstruction", "options_from", "reconstruct"]


def __getattr__(name: str) -> Any:
    if name in ("Reconstruction", "reconstruct"):
        from mpf_core import pipeline

        return getattr(pipeline, name)
    raise AttributeError(name)
