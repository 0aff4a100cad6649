"""What a caller says about a webhook when submitting a job."""

from __future__ import annotations

import base64
import binascii
import json
from dataclasses import asdict, dataclass
from typing import Any

from service.jobs.model import JobState
from service.problems import Problem
from service.webhooks.target import ForbiddenTarget, parse

SECRET_PREFIX = "whsec_"  # noqa: S105  not a secret
_STATES = tuple(state.value for state in JobState)
_ADVICE = 'Send {"url": "https://…", "secret": "whsec_…", "events": ["succeeded", "failed"]}.'


@dataclass(frozen=True)
class Wish:
    """secret: "whsec_" and base64 of at least 24 bytes; events: the states to hear of."""

    url: str
    secret: str
    events: tuple[str, ...]

    def as_record(self) -> dict[str, Any]:
        """As the job's record holds it."""
        return asdict(self)

    def key(self) -> bytes:
        """The bytes to sign with."""
        return base64.b64decode(self.secret.removeprefix(SECRET_PREFIX))


def wish_from(text: str) -> Wish | None:
    """The wish in a form field; raises Problem if it cannot be granted."""
    if not text.strip():
        return None
    try:
        given = json.loads(text)
        events = tuple(given.get("events", ("succeeded", "failed", "cancelled")))
        wish = Wish(given["url"], given["secret"], events)
        parse(wish.url)
        long_enough = len(base64.b64decode(wish.secret.removeprefix(SECRET_PREFIX), validate=True))
    except (ValueError, KeyError, TypeError, AttributeError, binascii.Error) as error:
        raise _refused(f"webhook cannot be read: {type(error).__name__} {error}") from error
    except ForbiddenTarget as error:
        raise _refused(str(error)) from error
    if not wish.secret.startswith(SECRET_PREFIX) or long_enough < 24:
        raise _refused("the webhook's secret is not whsec_ and base64 of at least 24 bytes")
    if not set(events) <= set(_STATES):
        raise _refused(f"the webhook's events are not among {', '.join(_STATES)}")
    return wish


def _refused(detail: str) -> Problem:
    return Problem("request.invalid", detail, where="webhook", advice=_ADVICE)
