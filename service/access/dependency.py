"""The caller of a request: known by an API key, or anybody where no key is needed."""

from __future__ import annotations

import math
from typing import Annotated

from anyio import to_thread
from fastapi import Depends, Request, Security
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer

from service.access.caller import Caller
from service.problems import Problem
from service.state import State, StateDep

_bearer = HTTPBearer(auto_error=False, description="An API key, as `mpf keys create` shows it.")


async def caller_of(
    request: Request,
    state: StateDep,
    credentials: Annotated[HTTPAuthorizationCredentials | None, Security(_bearer)],
) -> Caller:
    """Who is asking; raises Problem if that is nobody, or somebody too often."""
    token = credentials.credentials if credentials else ""
    if "authorization" in request.headers:
        caller = await to_thread.run_sync(_owner_of, state, token)
    elif state.settings.require_keys:
        raise Problem(
            "access.denied", "an API key is needed", where="Authorization",
            advice="Send `Authorization: Bearer mpf_…`.",
        )  # fmt: skip
    else:
        caller = Caller()
    if state.settings.requests_per_minute:
        address = request.client.host if request.client else ""
        await to_thread.run_sync(_count, state, caller.owner or address)
    return caller


def _owner_of(state: State, token: str) -> Caller:
    key = state.keys.find(token)
    if key is None:
        raise Problem("access.denied", "the API key is not valid", where="Authorization")
    return Caller(key.id)


def _count(state: State, who: str) -> None:
    wait = state.rates.seconds_to_wait(who)
    if wait > 0:
        raise Problem("rate.exceeded", "too many requests", retry_after=math.ceil(wait))


CallerDep = Annotated[Caller, Depends(caller_of)]
