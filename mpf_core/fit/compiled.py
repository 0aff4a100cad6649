"""All loops that a fit calls, compiled before anything is timed."""

from __future__ import annotations

from types import ModuleType

import torch

from mpf_core.field import plain
from mpf_core.field.pointwise import functions, functions_of_theta, loops
from mpf_core.progress import CancelCheck

TERMS = "mpf_core.fit.adjoints"  # by name: it loads the compiler, which may not be there


def prepare(kept: torch.dtype, cancel: CancelCheck | None = None) -> ModuleType:
    """The functions that work on arrays kept in that type (`pointwise`), once all is compiled.

    Raises Cancelled when `cancel` says so, which is asked before each of the small compilations.
    """
    functions_of_theta(cancel)
    found = functions(kept, cancel)
    return found if found is plain or loops(TERMS, cancel) is not None else plain
