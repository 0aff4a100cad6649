"""Threads that share one step's work: each takes a part of the points, on one core.

Data-parallel blocks beat threads inside every operation: there is no barrier after each of the
hundreds of small operations of a step, and a busy machine slows a step by the share of time that it
takes, not by a wait at every barrier. Results depend on the number of threads (the order of sums),
not on timing.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from itertools import pairwise
from typing import TypeVar

import torch

from mpf_core.heeding import one_by_one, together

S = TypeVar("S")
T = TypeVar("T")

_executor: ThreadPoolExecutor | None = None
_count = 1
_ours = threading.local()


@contextmanager
def workers(threads: int) -> Iterator[None]:
    """Within, `shared` uses so many threads, and torch one for each operation.

    Denormals, which slow products down, count as zero on those threads. On the caller's they do
    not: building a KD-tree over coordinates of exactly 0 would then never end.
    """
    global _executor, _count
    before = _executor, _count, torch.get_num_threads()
    torch.set_num_threads(1)
    executor = None if threads == 1 else ThreadPoolExecutor(threads, "mpf", _prepare)
    _executor, _count = executor, threads
    try:
        yield
    finally:
        _executor, _count, threads_before = before
        torch.set_num_threads(threads_before)
        if executor is not None:
            executor.shutdown()


@contextmanager
def flushed_denormals() -> Iterator[None]:
    """Denormals count as zero on this thread; for computations that build no KD-tree."""
    torch.set_flush_denormal(True)
    try:
        yield
    finally:
        torch.set_flush_denormal(False)


def shared(job: Callable[[slice], T], size: int, *, smallest: int = 1) -> list[T]:
    """job(part) for contiguous parts of range(size), one for each thread, in order.

    Parts have at least `smallest` members, so that little work stays on one thread.
    """
    parts = _parts(size, max(1, min(_count, size // smallest)))
    return [job(parts[0])] if len(parts) == 1 else mapped(job, parts)


def mapped(job: Callable[[S], T], items: Iterable[S]) -> list[T]:
    """job of each item, in order, each on the next thread that is free: the results do not depend
    on the number of threads."""
    # A thread of ours that waited for the others would wait for itself.
    if _executor is None or getattr(_ours, "prepared", False):
        return one_by_one(job, items)
    return together(_executor, job, items)


def _parts(size: int, count: int) -> Sequence[slice]:
    edges = [size * k // count for k in range(count + 1)]
    return [slice(low, high) for low, high in pairwise(edges)]


def _prepare() -> None:
    """Denormals are a setting of each thread, and so is recording for autograd."""
    _ours.prepared = True
    torch.set_flush_denormal(True)
    torch.set_grad_enabled(False)
