"""Threads that share work: in order, on every thread, and never waiting for themselves."""

from __future__ import annotations

import threading

import pytest
import torch

from mpf_core.parallel import mapped, shared, workers


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_parts_come_back_in_order_and_cover_everything(threads: int) -> None:
    with workers(threads):
        parts = shared(lambda part: list(range(10))[part], 10)
        assert [one for part in parts for one in part] == list(range(10))
        assert len(parts) == threads
        assert len(shared(lambda part: part, 10, smallest=10)) == 1


@pytest.mark.timeout(30)
@pytest.mark.parametrize("threads", [1, 2, 3])
def test_items_come_back_in_order_also_from_within_shared_work(threads: int) -> None:
    def row(first: int) -> list[int]:
        return mapped(lambda second: 10 * first + second, range(3))

    with workers(threads):
        assert mapped(row, range(5)) == [[10 * k, 10 * k + 1, 10 * k + 2] for k in range(5)]
        assert mapped(row, []) == []


@pytest.mark.timeout(30)
def test_work_may_be_shared_within_shared_work() -> None:
    def outer(part: slice) -> list[tuple[str, int]]:
        inner = shared(lambda rows: (threading.current_thread().name, rows.stop - rows.start), 8)
        return inner * (part.stop - part.start)

    with workers(2):
        for part in shared(outer, 2):
            # Each of our threads does all of its inner work itself.
            assert len({name for name, _ in part}) == 1
            assert sum(count for _, count in part) == 8


def test_the_callers_settings_come_back() -> None:
    before = torch.get_num_threads()
    with workers(2):
        assert torch.get_num_threads() == 1
    assert torch.get_num_threads() == before
