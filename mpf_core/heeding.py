"""Ending a long computation from wherever it is.

Reading a cloud, looking at its neighbourhoods and starting from them is the work of many small
functions, of which none should have to know that somebody may want to stop. Those that the time
goes to call `heed` between two pieces of work; whoever began it all says what that does.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar, copy_context
from functools import partial
from typing import TypeVar

S = TypeVar("S")
T = TypeVar("T")

_check: ContextVar[Callable[[], None] | None] = ContextVar("check", default=None)


@contextmanager
def heeding(check: Callable[[], None]) -> Iterator[None]:
    """Within, `heed` calls `check`, which raises if the work is to end."""
    before = _check.set(check)
    try:
        yield
    finally:
        _check.reset(before)


def heed() -> None:
    """Raises what the nearest `heeding` around raises; nothing outside of any."""
    check = _check.get()
    if check is not None:
        check()


def handed_on(job: Callable[[S], T], items: Iterable[S]) -> list[Callable[[], T]]:
    """`job` of each item as calls for other threads, which heed what the caller does."""
    return [partial(copy_context().run, _heeded, job, item) for item in items]


def _heeded(job: Callable[[S], T], item: S) -> T:
    heed()
    return job(item)
