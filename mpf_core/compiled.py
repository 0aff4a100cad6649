"""All loops of a reconstruction, compiled before anything is timed."""

from __future__ import annotations

from types import ModuleType

import torch

from mpf_core.field import plain
from mpf_core.fit import compiled
from mpf_core.progress import CancelCheck
from mpf_core.surface import intersections


def prepare_loops(kept: torch.dtype, cancel: CancelCheck | None = None) -> ModuleType:
    """Those of a fit with arrays kept in that type, which are returned, and of what follows it.

    Raises Cancelled when `cancel` says so, which is asked before each of the small compilations.
    """
    found = compiled.prepare(kept, cancel)
    return found if intersections.compiled_walk(cancel) is not None else plain
