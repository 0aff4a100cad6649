"""A real browser, Debian's Chromium with its software WebGL, at a real service."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import pytest
from playwright.sync_api import Browser, BrowserContext, Page, expect, sync_playwright

from tests.browser.served import Served, torus
from tests.services import PATIENCE, REPOSITORY, running

NAMES = ("chromium", "chromium-browser", "google-chrome")
FLAGS = [
    "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader", "--host-resolver-rules=MAP mpf.test 127.0.0.1",
]  # fmt: skip
AXE = REPOSITORY / "service" / "web" / "node_modules" / "axe-core" / "axe.min.js"

expect.set_options(timeout=15_000 * PATIENCE)


def chromium() -> str:
    """The browser: MPF_CHROMIUM, or the first of NAMES that is there."""
    found = os.environ.get("MPF_CHROMIUM") or next(filter(None, map(shutil.which, NAMES)), None)
    if found is None:
        reason = "no Chromium here: scripts/browser says why, and how to get one"
        if os.environ.get("CI"):
            pytest.fail(reason)
        pytest.skip(reason)
    return found


# Of the package, not of the session: while Playwright runs, no other test may have an event loop.
@pytest.fixture(scope="package")
def browser() -> Iterator[Browser]:
    program = chromium()
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=FLAGS)
        yield browser
        browser.close()


@pytest.fixture
def context(browser: Browser) -> Iterator[BrowserContext]:
    context = browser.new_context(viewport={"width": 1280, "height": 800}, accept_downloads=True)
    context.set_default_timeout(30_000 * PATIENCE)
    yield context
    context.close()


@pytest.fixture
def page(context: BrowserContext) -> Iterator[Page]:
    """A page in which nothing may be thrown, and nothing may be stopped by its policy."""
    page = context.new_page()
    wrong = watched(page)
    yield page
    assert not wrong, wrong


def watched(page: Page) -> list[str]:
    """What goes wrong in a page, as it happens; unanswered requests are the tests' own doing."""
    wrong: list[str] = []
    page.on("pageerror", lambda error: wrong.append(str(error)))

    def heard(message: Any) -> None:
        if message.type == "error" and "Failed to load resource" not in message.text:
            wrong.append(message.text)

    page.on("console", heard)
    return wrong


@pytest.fixture(scope="package")
def served() -> Iterator[Served]:
    with running(Served) as service:
        yield service


@pytest.fixture(scope="package")
def finished(served: Served) -> str:
    """A job that has succeeded."""
    return served.fitted(torus())


@pytest.fixture(scope="package")
def axe() -> str:
    """axe-core's script; npm's packages are brought in if they are not here."""
    if not AXE.is_file():
        subprocess.run([sys.executable, "scripts/web.py", "--check"], cwd=REPOSITORY, check=True)
    return AXE.read_text(encoding="utf-8")
