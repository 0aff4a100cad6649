"""Which functions do the pointwise work of a sweep: `fused` where they can be compiled, else `plain`.

Compiling takes some seconds once for each type of array, a fraction of one where the cache of an
earlier process serves (numba keeps it beside the package or in NUMBA_CACHE_DIR).
"""

from __future__ import annotations

import os
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import ModuleType

import torch

from mpf_core.errors import Cancelled
from mpf_core.field import plain
from mpf_core.progress import CancelCheck

THETA = "theta"  # θ alone, beside the types in which a fit keeps its arrays

_lock = threading.RLock()
_compiled: dict[torch.dtype | str, ModuleType] = {}
_reason: str | None = None  # why nothing is compiled in this process


def functions(kept: torch.dtype | str, cancel: CancelCheck | None = None) -> ModuleType:
    """`fused`, compiled for arrays kept in that type (or THETA), or `plain`.

    Raises Cancelled when `cancel` says so, which is asked before each of the small compilations.
    """
    if kept not in (torch.float32, torch.bfloat16, THETA):
        return plain
    found = _compiled.get(kept)
    if found is None:
        with _lock:
            found = _compiled.get(kept) or _compile(kept, cancel)
            _compiled[kept] = found
    return found


def why_plain() -> str | None:
    """Why the loops are not compiled, once that was tried in vain."""
    return _reason


@contextmanager
def uncompiled(reason: str = "asked for") -> Iterator[None]:
    """Within, all is `plain`: what to compare with."""
    global _reason
    before = dict(_compiled), _reason
    _compiled.clear()
    _reason = reason
    try:
        yield
    finally:
        _compiled.clear()
        _compiled.update(before[0])
        _reason = before[1]


def _compile(kept: torch.dtype | str, cancel: CancelCheck | None) -> ModuleType:
    global _reason
    if _reason is not None:
        return plain
    try:
        from mpf_core.field import fused

        steps = fused.compilations_of_theta() if kept == THETA else fused.compilations(kept)
        for step in steps:
            if cancel is not None and cancel():
                raise Cancelled("cancelled while loops were compiled", where="compilation")
            step()
    except Cancelled:
        raise
    except Exception as error:  # a compiler fails in ways of its own; a fit can do without it
        _reason = f"{type(error).__name__}: {error}".splitlines()[0]
        return plain
    return fused
