"""The caller of a request."""

from __future__ import annotations

from typing import Annotated

from fastapi import Depends

from service.access.caller import Caller


def caller_of() -> Caller:
    """Anybody on this machine, as long as there are no keys."""
    return Caller()


CallerDep = Annotated[Caller, Depends(caller_of)]
