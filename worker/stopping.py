"""Why a running job is told to stop, in the one process that runs it."""

from __future__ import annotations

import threading

_hand_back = threading.Event()


def request_hand_back() -> None:
    """The worker is leaving: stop and let another one continue."""
    _hand_back.set()


def hand_back_requested() -> bool:
    """Whether the worker is leaving."""
    return _hand_back.is_set()
