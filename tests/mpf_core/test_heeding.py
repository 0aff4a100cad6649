"""A wish to stop is heard inside of what knows nothing of it, on every thread."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import numpy as np
import pytest

from mpf_core.cloud.neighbors import analyse
from mpf_core.errors import Cancelled
from mpf_core.heeding import Late, heed, heeding, in_parts, no_later
from mpf_core.parallel import mapped, workers
from tests.mpf_core.clouds import sphere


class Wish:
    """Raises Cancelled from the call after `patience` on."""

    def __init__(self, patience: int):
        self.patience, self.calls = patience, 0

    def __call__(self) -> None:
        self.calls += 1
        if self.calls > self.patience:
            raise Cancelled("enough", where="here")


def test_outside_of_any_nothing_is_heeded() -> None:
    heed()
    with heeding(Wish(0)):
        pass
    heed()


def test_the_innermost_is_heeded_and_then_the_one_around() -> None:
    outer, inner = Wish(9), Wish(9)
    with heeding(outer):
        with heeding(inner):
            heed()
        heed()
    assert (outer.calls, inner.calls) == (1, 1)


def test_what_takes_too_long_ends_as_well_as_what_is_cancelled() -> None:
    now, wish = [0.0], Wish(2)
    with heeding(wish), no_later(lambda: now[0], 1.0):
        heed()
        now[0] = 1.5
        with pytest.raises(Late):
            heed()
        with pytest.raises(Cancelled):
            heed()


def test_an_analysis_ends_in_its_midst() -> None:
    whole, wish = Wish(10**6), Wish(1)
    points = sphere(40_000)
    with heeding(whole):
        analyse(points, threads=1)
    with heeding(wish), pytest.raises(Cancelled):
        analyse(points, threads=1)
    assert (wish.calls, whole.calls) == (2, 10)  # before each of five parts, and in it


@pytest.mark.parametrize("threads", [1, 2])
def test_work_shared_between_threads_ends(threads: int) -> None:
    """Between two of its parts, though these heed nothing, and only the caller is asked."""
    done: list[int] = []
    asked: set[int] = set()
    begin = time.monotonic()

    def check() -> None:
        asked.add(threading.get_ident())
        if time.monotonic() - begin > 0.3:
            raise Cancelled("enough", where="here")

    def job(item: int) -> None:
        time.sleep(0.05)
        done.append(item)

    with workers(threads), heeding(check):
        with pytest.raises(Cancelled):
            mapped(job, range(200))
        count = len(done)
    assert asked == {threading.get_ident()}
    assert count < 40
    assert len(done) <= count + threads


def test_what_a_job_raises_is_raised() -> None:
    def job(item: int) -> int:
        if item == 3:
            raise TimeoutError("mine")
        return item

    with workers(2), pytest.raises(TimeoutError, match="mine"):
        mapped(job, range(10))


def test_threads_of_others_heed_nothing() -> None:
    heard = []

    def other(job: Callable[[], None]) -> None:
        try:
            job()
        except Cancelled as error:
            heard.append(error)

    with heeding(Wish(0)):
        thread = threading.Thread(target=other, args=(heed,))
        thread.start()
        thread.join()
    assert not heard


def test_results_do_not_depend_on_being_heeded() -> None:
    points = sphere(2000)
    alone = analyse(points, threads=2)
    with heeding(Wish(10**6)):
        heeded = analyse(points, threads=2)
    assert np.array_equal(alone.normals, heeded.normals)


@pytest.mark.parametrize("threads", [1, 2, -1])
def test_parts_cover_all_rows_and_come_back_in_order(threads: int) -> None:
    def work(part: slice) -> list[int]:
        return list(range(100))[part]

    assert [i for some in in_parts(work, 100, threads, chunk=7) for i in some] == list(range(100))
    assert in_parts(work, 0, threads) == []


def test_an_analysis_does_not_depend_on_the_number_of_threads() -> None:
    points = np.concatenate([sphere(9000), 0.97 * sphere(9000)])
    one, two = (analyse(points, threads=threads) for threads in (1, 2))
    for name in ("normals", "tangents", "gap", "rim", "links", "consistent"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
