"""All loops are compiled together, or none is used."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from mpf_core.compiled import prepare_loops
from mpf_core.errors import Cancelled
from mpf_core.field import plain, pointwise
from mpf_core.surface import meeting
from mpf_core.surface.intersections import self_intersections
from mpf_core.surface.mesh import Mesh

CROSSING = Mesh(
    np.array([[0.0, 0, 0], [2, 0, 0], [0, 2, 0], [0.5, 0.5, -1], [0.5, 0.5, 1], [2, 2, 1]]),
    np.array([[0, 1, 2], [3, 4, 5]]),
)


def full() -> None:
    raise OSError(28, "No space left on device")


def test_without_the_walk_nothing_is_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(meeting, "compilations", lambda: iter([full]))
    monkeypatch.setattr(pointwise, "_chosen", [pointwise.Choice()])
    assert prepare_loops(torch.float32) is plain
    assert "No space left" in (pointwise.why_plain() or "")
    assert self_intersections(CROSSING).tolist() == [[0, 1]]


def test_what_was_cancelled_is_compiled_later(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pointwise, "_chosen", [pointwise.Choice()])
    pointwise.functions_of_theta()
    pointwise.functions(torch.float32)
    begun: list[None] = []
    compilations = meeting.compilations
    monkeypatch.setattr(meeting, "compilations", lambda: iter([lambda: begun.append(None)] * 2))
    with pytest.raises(Cancelled, match="compiled"):
        prepare_loops(torch.float32, lambda: len(begun) == 1)
    monkeypatch.setattr(meeting, "compilations", compilations)
    assert prepare_loops(torch.float32) is not plain
    assert self_intersections(CROSSING).tolist() == [[0, 1]]
