"""The caller of a request: known by an API key, or anybody where no key is needed."""

from __future__ import annotations

import math
from typing import Annotated

from fastapi import Depends, Request, Security
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer

from service.access.caller import Caller
from service.problems import Problem
from service.state import StateDep

_bearer = HTTPBearer(auto_error=False, description="An API key, as `mpf keys create` shows it.")


def caller_of(
    request: Request,
    state: StateDep,
    credentials: Annotated[HTTPAuthorizationCredentials | None, Security(_bearer)],
) -> Caller:
    """Who is asking; raises Problem if that is nobody, or somebody too often."""
    caller = _known(state, request, credentials)
    address = request.client.host if request.client else ""
    wait = state.rates.seconds_to_wait(caller.owner or address)
    if wait > 0:
        raise Problem("rate.exceeded", "too many requests", retry_after=math.ceil(wait))
    return caller


def _known(
    state: StateDep, request: Request, credentials: HTTPAuthorizationCredentials | None
) -> Caller:
    if "authorization" in request.headers:
        key = state.keys.find(credentials.credentials) if credentials else None
        if key is None:
            raise Problem("access.denied", "the API key is not valid", where="Authorization")
        return Caller(key.id)
    if state.settings.require_keys:
        raise Problem(
            "access.denied", "an API key is needed", where="Authorization",
            advice="Send `Authorization: Bearer mpf_…`.",
        )  # fmt: skip
    return Caller()


CallerDep = Annotated[Caller, Depends(caller_of)]
