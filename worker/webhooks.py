"""Delivers webhooks, signed as Standard Webhooks has it, beside the jobs and never within one."""

from __future__ import annotations

import base64
import hashlib
import hmac
import http.client
import json
import logging
import random
import socket
import ssl
import time
from typing import Any

from service.events.store import Event, EventStore
from service.jobs.model import Job
from service.jobs.store import JobStore
from service.settings import Settings
from service.webhooks.store import Delivery, WebhookStore
from service.webhooks.target import ForbiddenTarget, Target, resolve
from service.webhooks.wish import Wish

log = logging.getLogger("mpf.webhooks")

CLAIM_SECONDS = 60.0
TIMEOUT_SECONDS = 10.0

# Pauses between tries, s: about 28 hours in all, each ± 10 %.
PAUSES = (5.0, 30.0, 120.0, 600.0, 1800.0, 3600.0, 3 * 3600.0, 8 * 3600.0, 14 * 3600.0)


class Deliverer:
    """One delivery at a time; any number of processes may run it."""

    def __init__(
        self, webhooks: WebhookStore, store: JobStore, events: EventStore, settings: Settings
    ):
        self._webhooks = webhooks
        self._store = store
        self._events = events
        self._settings = settings

    def round(self) -> None:
        """Deliver what is due."""
        while (delivery := self._webhooks.claim(CLAIM_SECONDS)) is not None:
            self._deliver(delivery)

    def _deliver(self, delivery: Delivery) -> None:
        job = self._store.get(delivery.job_id)
        event = self._events.one(delivery.job_id, delivery.event_id)
        wish = _wish(job)
        if job is None or event is None or wish is None or event.data["state"] not in wish.events:
            self._webhooks.done(delivery)
            return
        status, error = self._send(wish, job, event)
        self._webhooks.note(delivery, status, error)
        log.info("job %s: webhook %s, try %s: %s", job.id, event.id, delivery.number,
                 error or status)  # fmt: skip
        if 200 <= status < 300 or status == http.HTTPStatus.GONE or delivery.number > len(PAUSES):
            self._webhooks.done(delivery)
        else:
            pause = PAUSES[delivery.number - 1] * self._settings.webhook_pause_factor
            self._webhooks.later(delivery, pause * random.uniform(0.9, 1.1))  # noqa: S311

    def _send(self, wish: Wish, job: Job, event: Event) -> tuple[int, str]:
        body = json.dumps(_payload(job, event)).encode()
        headers = signed(wish, f"{job.id}.{event.id}", int(time.time()), body)
        try:
            target = resolve(wish.url, self._settings.webhook_networks)
            return _post(target, body, headers), ""
        except ForbiddenTarget as error:
            return 0, str(error)
        except (OSError, http.client.HTTPException) as error:
            return 0, f"{type(error).__name__}: {error}"


def signed(wish: Wish, message_id: str, now: int, body: bytes) -> dict[str, str]:
    """The headers of Standard Webhooks: id, time and signature over both and the body."""
    text = f"{message_id}.{now}.".encode() + body
    signature = base64.b64encode(hmac.digest(wish.key(), text, hashlib.sha256)).decode()
    return {
        "Content-Type": "application/json",
        "User-Agent": "metric-phase-fields",
        "webhook-id": message_id,
        "webhook-timestamp": str(now),
        "webhook-signature": f"v1,{signature}",
    }


def _payload(job: Job, event: Event) -> dict[str, Any]:
    return {
        "type": f"job.{event.data['state']}",
        "timestamp": int(event.id.partition("-")[0]) / 1000,
        "data": {"id": job.id, "label": job.label, "href": f"/jobs/{job.id}"} | event.data,
    }


def _wish(job: Job | None) -> Wish | None:
    if job is None or not job.webhook:
        return None
    return Wish(job.webhook["url"], job.webhook["secret"], tuple(job.webhook["events"]))


class _Pinned(http.client.HTTPConnection):
    """Connects to the address that was checked, and speaks TLS under the name that was asked."""

    def __init__(self, target: Target):
        super().__init__(target.host, target.port, timeout=TIMEOUT_SECONDS)
        self._target = target

    def connect(self) -> None:
        address = (self._target.address, self._target.port)
        plain = socket.create_connection(address, TIMEOUT_SECONDS)
        if self._target.secure:
            context = ssl.create_default_context()
            self.sock = context.wrap_socket(plain, server_hostname=self._target.host)
        else:
            self.sock = plain


def _post(target: Target, body: bytes, headers: dict[str, str]) -> int:
    """The status of the answer; redirects are not followed, the body is not read."""
    connection = _Pinned(target)
    try:
        connection.request("POST", target.path, body, headers)
        return connection.getresponse().status
    finally:
        connection.close()
