"""Lines of the log are JSON objects that name the job they are about."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator
from typing import Any

import pytest
from starlette.testclient import TestClient

from service.app import create_app
from service.logs import OURS, about, configure_logging
from service.settings import Settings
from tests.services import form

log = logging.getLogger("mpf.test")


@pytest.fixture(autouse=True)
def _as_before() -> Iterator[None]:
    before = [(n, logging.getLogger(n)) for n in OURS]
    kept = [(logger, logger.handlers[:], logger.level, logger.propagate) for _, logger in before]
    yield
    for logger, handlers, level, propagate in kept:
        logger.handlers[:], logger.propagate = handlers, propagate
        logger.setLevel(level)


def lines(capsys: pytest.CaptureFixture[str]) -> list[dict[str, Any]]:
    return [json.loads(line) for line in capsys.readouterr().err.splitlines()]


def test_a_line_is_about_the_job_that_it_begins_with_or_was_written_for(
    capsys: pytest.CaptureFixture[str],
) -> None:
    configure_logging(Settings(log_format="json"))
    log.info("job %s: attempt %s starts", "a" * 32, 2)
    with about("b" * 32):
        log.warning("two\nlines")
    try:
        raise ValueError("why")
    except ValueError:
        log.exception("failed", extra={"about": {"seconds": 1.5}})
    first, second, third = lines(capsys)
    assert first["message"] == f"job {'a' * 32}: attempt 2 starts"
    assert (first["job"], first["level"], first["logger"]) == ("a" * 32, "info", "mpf.test")
    assert (second["job"], second["message"]) == ("b" * 32, "two\nlines")
    assert "job" not in third
    assert third["seconds"] == 1.5
    assert "ValueError: why" in third["error"]


def test_text_names_the_job_too(capsys: pytest.CaptureFixture[str]) -> None:
    configure_logging(Settings(log_format="text"))
    with about("c" * 32):
        log.info("reading")
    log.info("plain %s", "words")
    first, second = capsys.readouterr().err.splitlines()
    assert first.endswith(f"reading [job {'c' * 32}]")
    assert second.endswith("plain words")


def test_changes_and_failures_are_written_down_and_polls_are_not(
    settings: Settings, capsys: pytest.CaptureFixture[str]
) -> None:
    quick = settings.model_copy(update={"content_check_bytes": 0})
    with TestClient(create_app(quick), base_url="http://localhost") as client:
        configure_logging(Settings(log_format="json"))
        job = client.post("/jobs", **form()).json()["id"]
        client.get(f"/jobs/{job}")
        client.post(f"/jobs/{job}/cancel")
        client.delete("/jobs/" + "0" * 32)
    told = [(line["method"], line["status"], line["job"]) for line in lines(capsys)]
    assert told == [("POST", 202, job), ("POST", 202, job), ("DELETE", 404, "0" * 32)]
