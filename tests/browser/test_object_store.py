"""The page over an object store: its policy admits no other origin, and downloads go there."""

from __future__ import annotations

import json
import re
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import BrowserContext, expect

from tests.browser.conftest import watched
from tests.browser.served import Served, torus
from tests.browser.test_whole_way import stage
from tests.objects import ObjectStore

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

PLAIN_HTTP = "The Cross-Origin-Opener-Policy header has been ignored, because the URL's origin was"
"""What the browser notes of each page that comes over plain HTTP from another machine."""

NAME = "mpf.test"
"""The browser finds this machine under it (conftest), but does not trust it like localhost."""


@pytest.fixture(scope="module")
def apart() -> Iterator[Served]:
    """A service whose files lie in a bucket."""
    with tempfile.TemporaryDirectory(prefix="mpf-") as folder:
        store = ObjectStore("moto", Path(folder))
        store.start()
        url = f"s3://{store.new_bucket()}/files"
        service = Served(
            Path(folder), MPF_STORE_URL=url, MPF_ALLOWED_HOSTS=json.dumps(["127.0.0.1", NAME]),
            **store.environment(),
        )  # fmt: skip
        service.start()
        yield service
        service.stop()
        store.stop()


@pytest.fixture(scope="module")
def kept(apart: Served) -> str:
    """A job that has succeeded there."""
    return apart.fitted(torus())


# Over plain HTTP browsers tell by Sec-Fetch-Dest who asks only where it is this machine.
@pytest.mark.parametrize("host", ["127.0.0.1", NAME])
def test_files_are_shown_and_saved(
    context: BrowserContext, apart: Served, kept: str, host: str, tmp_path: Path
) -> None:
    page = context.new_page()
    wrong = watched(page)
    assert apart.client.get(f"/jobs/{kept}/report.json").status_code == 307
    address = f"{apart.url.replace('127.0.0.1', host)}/#/jobs/{kept}"
    page.goto(address)
    stage(page, 1)
    expect(page.locator(".headline")).to_contain_text("median distance")
    shows = page.locator("canvas")
    expect(shows).to_have_attribute("data-shows", re.compile(r"500 points"))
    expect(shows).to_have_attribute("data-shows", re.compile(r"triangles"))
    with page.expect_download() as waiting:
        page.get_by_role("button", name="Report (JSON)").click()
    waiting.value.save_as(tmp_path / "report.json")
    assert "timings" in json.loads((tmp_path / "report.json").read_text())
    assert page.url == address, "a file that is saved does not take the page's place"
    assert [told for told in wrong if not told.startswith(PLAIN_HTTP)] == []
