"""Webhooks arrive signed, are tried again, and never reach a private network unasked."""

from __future__ import annotations

import base64
import hashlib
import hmac
import json
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from typing import Any

import pytest
from starlette.testclient import TestClient

from service.app import create_app
from service.settings import Settings
from service.webhooks.target import ForbiddenTarget, parse, resolve
from tests.services import form, running_worker, wait_for

KEY = bytes(range(32))
SECRET = "whsec_" + base64.b64encode(KEY).decode()


class Receiver(HTTPServer):
    """Fails the first request, takes all others."""

    heard: list[tuple[dict[str, str], bytes]]


class _Handler(BaseHTTPRequestHandler):
    server: Receiver

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["content-length"]))
        self.server.heard.append(({k.lower(): v for k, v in self.headers.items()}, body))
        self.send_response(500 if len(self.server.heard) == 1 else 204)
        self.end_headers()

    def log_message(self, *_: Any) -> None:
        pass


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    server = Receiver(("127.0.0.1", 0), _Handler)
    server.heard = []
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield server
    server.shutdown()
    thread.join()
    server.server_close()


def submit(client: TestClient, name: str, url: str, events: list[str]) -> str:
    request = form(name=name)
    request["data"]["webhook"] = json.dumps({"url": url, "secret": SECRET, "events": events})
    answer = client.post("/jobs", **request)
    assert answer.status_code == 202, answer.text
    assert SECRET not in answer.text
    return str(answer.json()["id"])


def test_a_webhook_is_signed_filtered_and_tried_again(
    settings: Settings, receiver: Receiver
) -> None:
    told = {"webhook_networks": ("127.0.0.0/8",), "webhook_pause_factor": 0.05}
    near = settings.model_copy(update=told)
    url = f"http://127.0.0.1:{receiver.server_port}/hook?x=1"
    with TestClient(create_app(near), base_url="http://localhost") as client, running_worker(near):
        job_id = submit(client, "ok.xyz", url, ["succeeded"])
        wait_for(lambda: len(receiver.heard) == 2, 40, "two tries")
        log = wait_for(
            lambda: _log_of_two(client.get(f"/jobs/{job_id}/deliveries").json()), 10, "the log"
        )
    assert [tried["status"] for tried in log] == [204, 500]
    (first, body), (second, again) = receiver.heard
    assert (body, first["webhook-id"]) == (again, second["webhook-id"])
    text = f"{first['webhook-id']}.{first['webhook-timestamp']}.".encode() + body
    expected = base64.b64encode(hmac.digest(KEY, text, hashlib.sha256)).decode()
    assert first["webhook-signature"] == f"v1,{expected}"
    message = json.loads(body)
    assert (message["type"], message["data"]["id"]) == ("job.succeeded", job_id)


def _log_of_two(answer: dict[str, Any]) -> list[dict[str, Any]] | None:
    tries: list[dict[str, Any]] = answer["deliveries"]
    return tries if len(tries) == 2 else None


def test_private_addresses_get_nothing(settings: Settings, receiver: Receiver) -> None:
    url = f"http://127.0.0.1:{receiver.server_port}/"
    with (
        TestClient(create_app(settings), base_url="http://localhost") as client,
        running_worker(settings),
    ):
        job_id = submit(client, "ok.xyz", url, ["succeeded"])
        tries = wait_for(
            lambda: client.get(f"/jobs/{job_id}/deliveries").json()["deliveries"], 40, "a try"
        )
    assert tries[0]["status"] == 0
    assert "not a public address" in tries[0]["error"]
    assert receiver.heard == []


@pytest.mark.parametrize(
    "url",
    [
        "http://127.0.0.1/", "http://[::1]/", "http://10.1.2.3/", "http://169.254.169.254/",
        "http://[::ffff:127.0.0.1]/", "http://0.0.0.0/", "http://2130706433/", "http://localhost/",
        "http://[fe80::1]/", "http://100.64.0.1/", "http://224.0.0.1/",
    ],
)  # fmt: skip
def test_addresses_that_are_refused(url: str) -> None:
    with pytest.raises(ForbiddenTarget):
        resolve(url, ())


@pytest.mark.parametrize(
    "url", ["ftp://a/", "http://", "http://u:p@a/", "http://a b/", "http://a:99999/", "x" * 3000]
)
def test_urls_that_cannot_take_webhooks(url: str) -> None:
    with pytest.raises(ForbiddenTarget):
        parse(url)
