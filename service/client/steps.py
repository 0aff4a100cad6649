"""What a client does, without doing it: each act is a generator of requests and pauses.

Who runs one sends the answers in, or throws the Unreachable that a request met. So the blocking
client and the asynchronous one are the same acts, run in two ways.
"""

from __future__ import annotations

import time
from collections.abc import Generator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import httpx2

from service.jobs.schemas import ProblemOut

T = TypeVar("T")

FIRST_PAUSE, LONGEST_PAUSE = 0.2, 5.0


@dataclass(frozen=True)
class Ask:
    """One request. `again`: whether it may be sent twice when no answer came."""

    method: str
    path: str
    params: Mapping[str, Any] = field(default_factory=dict)
    headers: Mapping[str, str] = field(default_factory=dict)
    json: Any = None
    content: bytes | None = None
    again: bool = True
    timeout: float = 60.0


@dataclass(frozen=True)
class Pause:
    """Wait so many seconds."""

    seconds: float


Steps = Generator[Ask | Pause, Any, T]


class Unreachable(Exception):
    """The service did not answer; str() says what was tried."""


class Refused(Exception):
    """The service answered with a problem (RFC 9457); its `code` may be branched on."""

    def __init__(self, problem: ProblemOut):
        super().__init__(f"{problem.detail} [{problem.code}]")
        self.problem = problem
        self.code = problem.code


def asked(ask: Ask, patience: float) -> Steps[httpx2.Response]:
    """The answer; a service that is away, full or busy is asked again for `patience` seconds.

    Raises Refused, Unreachable.
    """
    deadline = time.monotonic() + patience
    pause = FIRST_PAUSE
    while True:
        try:
            answer: httpx2.Response = yield ask
        except Unreachable:
            if not ask.again or time.monotonic() + pause > deadline:
                raise
        else:
            if answer.status_code < 400:
                return answer
            if answer.status_code not in (423, 429, 502, 503, 504):
                raise problem_in(answer)
            if time.monotonic() + pause > deadline:
                raise problem_in(answer)
            told = answer.headers.get("retry-after", "")
            pause = max(pause, min(float(told) if told.isdigit() else 0.0, LONGEST_PAUSE))
        yield Pause(pause)
        pause = min(2 * pause, LONGEST_PAUSE)


def problem_in(answer: httpx2.Response) -> Refused:
    """What the answer complains of; proxies in between may write something else than problems."""
    try:
        return Refused(ProblemOut.model_validate(answer.json()))
    except ValueError:
        status = answer.status_code
        detail = f"{answer.request.method} {answer.request.url.path}: HTTP {status}"
        return Refused(
            ProblemOut(type="about:blank", title="", status=status, detail=detail, code="internal")
        )


def with_key(ask: Ask, key: str | None) -> Ask:
    """The request with the API key, if there is one."""
    if key is None:
        return ask
    return replace(ask, headers={"Authorization": f"Bearer {key}"} | dict(ask.headers))
