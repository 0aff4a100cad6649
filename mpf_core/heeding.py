"""Ending a long computation from wherever it is.

Reading a cloud, looking at its neighbourhoods and starting from them is the work of many small
functions, of which none should have to know that somebody may want to stop. Those that the time
goes to call `heed` between two pieces of work; whoever began it all says what that does.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from threading import Event
from typing import TypeVar

S = TypeVar("S")
T = TypeVar("T")

ROWS_AT_ONCE = 8192  # on each thread: so that memory stays a constant beside the cloud
PATIENCE = 0.2  # seconds between two looks while other threads work

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


@contextmanager
def no_later(clock: Callable[[], float], end: float) -> Iterator[None]:
    """Within, `heed` raises Late once `clock` says that it is later than `end`."""
    around = _check.get()

    def check() -> None:
        if around is not None:
            around()
        if clock() > end:
            raise Late

    with heeding(check):
        yield


class Late(Exception):
    """The time for the work is over; whoever set it does without."""


def together(executor: Executor, job: Callable[[S], T], items: Iterable[S]) -> list[T]:
    """`job` of each item, in order, on the threads of `executor`. The caller alone is asked, while
    it waits; they end where they heed when it does."""
    ended = Event()

    def end() -> None:
        if ended.is_set():
            raise _Ended

    def one(item: S) -> T:
        with heeding(end):
            heed()
            return job(item)

    futures = [executor.submit(one, item) for item in items]
    try:
        return [_awaited(future) for future in futures]
    except BaseException:
        ended.set()
        for future in futures:
            future.cancel()
        raise


def one_by_one(job: Callable[[S], T], items: Iterable[S]) -> list[T]:
    """`job` of each item, in order, on this thread, heeding before each."""

    def one(item: S) -> T:
        heed()
        return job(item)

    return [one(item) for item in items]


def in_parts(
    work: Callable[[slice], T], count: int, threads: int, chunk: int = ROWS_AT_ONCE
) -> list[T]:
    """`work` on slices that cover `count` rows, in order, on threads: NumPy lets go of the lock."""
    parts = [slice(start, min(start + chunk, count)) for start in range(0, count, chunk)]
    return on_threads(work, parts, threads)


def on_threads(work: Callable[[S], T], items: Iterable[S], threads: int) -> list[T]:
    """`work` of each item, in order, on so many threads; on as many as help if negative."""
    if threads == 1:
        return one_by_one(work, items)
    with ThreadPoolExecutor(max_workers=threads if threads > 0 else None) as pool:
        return together(pool, work, items)


class _Ended(Exception):
    """The caller has gone: nobody waits for this any more."""


def _awaited(future: Future[T]) -> T:
    while True:
        heed()
        try:
            return future.result(timeout=PATIENCE)
        except TimeoutError:
            if future.done():
                raise
