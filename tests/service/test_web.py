"""The browser client as the API serves it: its policy, its sizes, nothing from elsewhere."""

from __future__ import annotations

import gzip
import re
from collections.abc import Iterator

import pytest
from starlette.testclient import TestClient

from service.app import create_app
from service.settings import Settings
from service.web.routes import STATIC

SCRIPT_BYTES = 400_000  # of all scripts together, compressed

needs_client = pytest.mark.skipif(
    not (STATIC / "index.html").is_file(), reason="scripts/setup builds the client"
)


@pytest.fixture
def client() -> Iterator[TestClient]:
    # Needs no Redis: the page comes whatever else is away.
    with TestClient(create_app(Settings()), base_url="http://127.0.0.1:8000") as client:
        yield client


@needs_client
def test_page_has_a_strict_policy_and_nothing_inline(client: TestClient) -> None:
    answer = client.get("/")
    assert answer.status_code == 200
    assert answer.headers["content-type"].startswith("text/html")
    policy = answer.headers["content-security-policy"]
    assert policy.startswith("default-src 'none'")
    assert "unsafe" not in policy and "http" not in policy and "data:" not in policy
    assert not re.search(r"<style|\sstyle=|\son\w+=|<script(?![^>]*\ssrc=)", answer.text)
    assert not re.search(r"(src|href)=\"(https?:)?//", answer.text)


@needs_client
def test_assets_are_kept_and_compressed(client: TestClient) -> None:
    page = client.get("/").text
    names = re.findall(r'"\./(assets/[^"]+)"', page)
    assert len(names) >= 3
    for name in names:
        plain = client.get(f"/{name}", headers={"Accept-Encoding": "identity"})
        packed = client.get(f"/{name}", headers={"Accept-Encoding": "gzip"})
        assert plain.status_code == packed.status_code == 200
        assert plain.content == packed.content
        assert packed.headers["content-encoding"] == "gzip"
        assert "immutable" in packed.headers["cache-control"]
        assert packed.headers["content-security-policy"].startswith("default-src 'none'")


@needs_client
def test_scripts_are_small() -> None:
    scripts = sorted(STATIC.glob("assets/*.js"))
    sizes = {path.name: len(gzip.compress(path.read_bytes(), 9)) for path in scripts}
    assert sum(sizes.values()) < SCRIPT_BYTES, sizes


@pytest.mark.parametrize("name", ["nothing.js", "..%2findex.html", "%2e%2e", "a/b.js", "x" * 300])
def test_what_is_no_asset_is_a_problem(client: TestClient, name: str) -> None:
    answer = client.get(f"/assets/{name}")
    assert answer.status_code == 404
    assert answer.json()["code"] == "not_found"
