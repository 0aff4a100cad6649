"""The committed OpenAPI document is the one that the code describes."""

from __future__ import annotations

import json

from service.openapi import DEFAULT_FILE, document
from service.problems import MEDIA_TYPE
from tests.services import REPOSITORY


def test_the_committed_document_is_current() -> None:
    committed = (REPOSITORY / DEFAULT_FILE).read_text(encoding="utf-8")
    assert committed == document(), "run `python -m service.openapi` and commit the result"


def test_every_error_is_documented_as_a_problem() -> None:
    for path in json.loads(document())["paths"].values():
        for operation in path.values():
            for status, response in operation["responses"].items():
                if status >= "400" and operation["operationId"] != "readyz":
                    assert list(response["content"]) == [MEDIA_TYPE]
