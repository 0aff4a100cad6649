"""Why a running job is told to stop, in the one process that runs it."""

from __future__ import annotations

import threading
from types import FrameType

_hand_back = threading.Event()


def hear(_signal: int, _frame: FrameType | None) -> None:
    """Signal handler: the worker is leaving; stop and let another one continue."""
    _hand_back.set()


def hand_back_requested() -> bool:
    """Whether the worker is leaving."""
    return _hand_back.is_set()
