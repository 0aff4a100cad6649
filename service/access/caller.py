"""Who is asking."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Caller:
    """owner: the id of the API key, or "" for anybody on this machine (loopback without keys)."""

    owner: str = ""
