"""Whatever is sent, alone or one after the other, is answered as the OpenAPI document says."""

from __future__ import annotations

import random
from collections.abc import Iterator
from typing import Any

import pytest
import schemathesis
from hypothesis import HealthCheck, given, settings
from schemathesis.checks import not_a_server_error
from schemathesis.core.failures import Failure, FailureGroup
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    response_headers_conformance,
    response_schema_conformance,
    status_code_conformance,
)

from service.settings import Settings
from tests.services import Server, running_api, running_worker, settings_for, sphere_xyz

pytestmark = [pytest.mark.slow]

CHECKS = [
    not_a_server_error,
    status_code_conformance,
    content_type_conformance,
    response_headers_conformance,
    response_schema_conformance,
]
BRIEF = settings(
    max_examples=4, deadline=None, derandomize=True, database=None,
    suppress_health_check=list(HealthCheck),
)  # fmt: skip
STEPS = settings(BRIEF, max_examples=5, stateful_step_count=6)
TIMEOUT = 30  # s; a request that hangs is a failure


class Feeder:
    """Puts what exists into half of the requests: random bytes never become a job by chance."""

    def __init__(self) -> None:
        self.chance = random.Random(5)  # noqa: S311
        self.known: dict[str, list[str]] = {"job_id": [], "upload_id": [], "token": []}

    def before_call(self, _context: Any, case: Any, kwargs: dict[str, Any]) -> None:
        kwargs.setdefault("timeout", TIMEOUT)
        for name, ids in self.known.items():
            if ids and name in (case.path_parameters or {}) and self.chance.random() < 0.7:
                case.path_parameters[name] = self.chance.choice(ids[-5:])
        headers = case.headers if case.headers is not None else {}
        if case.operation.path.startswith("/uploads") and self.chance.random() < 0.8:
            headers["Tus-Resumable"] = "1.0.0"
        query = case.query if case.query is not None else {}
        if "wait" in query:
            query["wait"] = self.chance.choice([0, 0.2, 61, "x"])
        if case.operation.label == "POST /jobs" and self.chance.random() < 0.7:
            # In place of whatever was made: a cloud, whose job the worker ends at once.
            case.media_type = "application/octet-stream"
            case.body = sphere_xyz()
            headers["Content-Type"] = case.media_type
            query["name"] = self.chance.choice(["ok.xyz", "line.xyz", "long-1.xyz"])
            query.pop("options", None)
            query.pop("webhook", None)
        case.headers, case.query = headers, query

    def after_call(self, _context: Any, case: Any, response: Any) -> None:
        place = dict(response.headers).get("location", [""])[0]
        for prefix, name in (("/jobs/", "job_id"), ("/uploads/", "upload_id")):
            if place.startswith(prefix):
                self.known[name].append(place.removeprefix(prefix))
        if response.status_code == 201 and case.operation.path.endswith("/shares"):
            self.known["token"].append(response.json()["href"].removeprefix("/shared/"))


@pytest.fixture(scope="module")
def api(
    shared_server: Server, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[tuple[str, Feeder]]:
    told: Settings = settings_for(
        shared_server,
        tmp_path_factory.mktemp("schemathesis"),
        content_check_bytes=0,
        inspect_seconds=5.0,
    )
    feeder = Feeder()

    @schemathesis.hook("before_call")
    def before(context: Any, case: Any, kwargs: dict[str, Any]) -> None:
        feeder.before_call(context, case, kwargs)

    @schemathesis.hook("after_call")
    def after(context: Any, case: Any, response: Any) -> None:
        feeder.after_call(context, case, response)

    with running_api(told) as url, running_worker(told):
        yield url, feeder
    schemathesis.hooks.unregister_all()


@pytest.fixture(scope="module")
def described(api: tuple[str, Feeder]) -> Any:
    found = schemathesis.openapi.from_url(f"{api[0]}/openapi.json")
    assert any(operation.ok().path == "/jobs" for operation in found.get_all_operations())
    return found


def test_each_endpoint_answers_as_documented(described: Any) -> None:
    wrong: list[str] = []
    operations = [found.ok() for found in described.get_all_operations()]
    assert len(operations) > 20
    for operation in operations:

        @BRIEF
        @given(case=operation.as_strategy())
        def answers_as_documented(case: Any) -> None:
            case.call_and_validate(checks=CHECKS)

        try:
            answers_as_documented()
        except (FailureGroup, Failure) as failure:
            wrong.append(f"{operation.label}: {failure}")
    assert not wrong, "\n\n".join(wrong)


def test_sequences_of_requests_are_answered_as_documented(
    api: tuple[str, Feeder], described: Any
) -> None:
    class Machine(described.as_state_machine()):  # type: ignore[misc]
        def validate_response(self, response: Any, case: Any, **kwargs: Any) -> None:
            case.validate_response(response, checks=CHECKS)

    Machine.run(settings=STEPS)
    assert len(api[1].known["job_id"]) > 3
