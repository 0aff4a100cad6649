"""Which functions do a sweep's pointwise work: `fused` where they can be compiled, else `plain`.

Compiling takes some seconds once for each type of array, a fraction of one where the cache of an
earlier process serves (numba keeps it beside the package or in NUMBA_CACHE_DIR).
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from importlib import import_module
from types import ModuleType

import torch

from mpf_core.errors import Cancelled
from mpf_core.field import plain
from mpf_core.progress import CancelCheck

FUSED = "mpf_core.field.fused"  # by name: it loads the compiler, which may not be there


class Choice:
    """What this process has compiled, by the type of the arrays; `reason`: why it compiles none."""

    def __init__(self, reason: str | None = None) -> None:
        self.reason = reason
        self._lock = threading.RLock()
        self._of_fits: dict[torch.dtype, ModuleType] = {torch.float64: plain}
        self._of_theta: ModuleType | None = None
        self._others: dict[str, ModuleType] = {}

    def functions(self, kept: torch.dtype, cancel: CancelCheck | None) -> ModuleType:
        found = self._of_fits.get(kept)
        if found is None:
            with self._lock:
                found = self._of_fits.get(kept) or self._compile(kept, cancel)
                self._of_fits[kept] = found
        return found

    def others(self, name: str, cancel: CancelCheck | None) -> ModuleType | None:
        with self._lock:
            if name not in self._others:
                module = self._tried(name, lambda module: module.compilations(), cancel)
                if module is None:
                    self._use_nothing()
                    return None
                self._others[name] = module
            return self._others[name]

    def _use_nothing(self) -> None:
        """Of what is compiled."""
        self._of_theta, self._of_fits = plain, dict.fromkeys(self._of_fits, plain)
        self._others.clear()

    def functions_of_theta(self, cancel: CancelCheck | None) -> ModuleType:
        if self._of_theta is None:
            with self._lock:
                self._of_theta = self._of_theta or self._compile(None, cancel)
        return self._of_theta

    def _compile(self, kept: torch.dtype | None, cancel: CancelCheck | None) -> ModuleType:
        return self._tried(FUSED, lambda fused: fused.compilations(kept), cancel) or plain

    def _tried(
        self,
        name: str,
        compilations: Callable[[ModuleType], Iterable[Callable[[], None]]],
        cancel: CancelCheck | None,
    ) -> ModuleType | None:
        """The module of that name, compiled; None, and nothing is tried again, where that fails."""
        if self.reason is not None:
            return None
        try:
            module = import_module(name)
            compile_all(compilations(module), cancel)
        except Cancelled:
            raise
        except Exception as error:  # a compiler fails in ways of its own; a fit can do without
            self.reason = told(error)
            return None
        return module


def compile_all(compilations: Iterable[Callable[[], None]], cancel: CancelCheck | None) -> None:
    """Run them; raises Cancelled when `cancel` says so, which is asked before each."""
    for compilation in compilations:
        if cancel is not None and cancel():
            raise Cancelled("cancelled while loops were compiled", where="compilation")
        compilation()


def told(error: Exception) -> str:
    """In one line, for the report."""
    return f"{type(error).__name__}: {error}".splitlines()[0]


_chosen = [Choice()]  # the last one holds


def functions(kept: torch.dtype, cancel: CancelCheck | None = None) -> ModuleType:
    """What works on a fit's arrays kept in that type; float64 is always `plain`.

    Raises Cancelled when `cancel` says so, which is asked before each of the small compilations.
    """
    return _chosen[-1].functions(kept, cancel)


def functions_of_theta(cancel: CancelCheck | None = None) -> ModuleType:
    """What works on θ alone, in float32; raises Cancelled likewise."""
    return _chosen[-1].functions_of_theta(cancel)


def loops(name: str, cancel: CancelCheck | None = None) -> ModuleType | None:
    """The module of that name, once its `compilations()` are done; None, and all is `plain` from
    then on, where they fail. Raises Cancelled likewise."""
    return _chosen[-1].others(name, cancel)


def why_plain() -> str | None:
    """Why loops are not compiled, once that was tried in vain."""
    return _chosen[-1].reason


@contextmanager
def uncompiled(reason: str = "not asked for") -> Iterator[None]:
    """Within, all is `plain`: what to compare with."""
    _chosen.append(Choice(reason))
    try:
        yield
    finally:
        _chosen.pop()
