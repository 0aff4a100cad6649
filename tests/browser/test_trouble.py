"""What people meet: a change of mind, a reload, a service that restarts, a file that is none."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import BrowserContext, Page, expect

from service.access.store import KeyStore
from service.connection import connect
from service.embedded import running_url
from service.settings import Settings
from tests.browser.conftest import watched
from tests.browser.looking import drawn, look, pixels
from tests.browser.served import Served, torus
from tests.browser.test_whole_way import ENDLESS, begin, choose_cloud, fill_in, stage
from tests.services import PATIENCE, running, wait_for

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]


@pytest.fixture
def own_service() -> Iterator[Served]:
    """One to be stopped."""
    with running(Served) as service:
        yield service


def test_cancel(page: Page, served: Served, axe: str) -> None:
    job = begin(page, served, **ENDLESS)
    expect(page.locator(".state")).to_have_text("running")
    page.get_by_role("button", name="Cancel").click()
    expect(page.locator(".state")).to_have_text("cancelled")
    expect(page.get_by_role("button", name="Run it again")).to_be_visible()
    look(page, "cancelled", axe)
    assert served.client.get(f"/jobs/{job}").json()["state"] == "cancelled"


def test_reload_in_the_middle(page: Page, served: Served) -> None:
    job = begin(page, served, **ENDLESS)
    expect(page.locator(".losses svg")).to_be_visible(timeout=60_000 * PATIENCE)
    known = page.evaluate(
        "id => JSON.parse(sessionStorage['mpf.history.' + id]).points.length", job
    )
    page.reload()
    # The points come back from the service, the curves from the tab, the preview from both.
    expect(page.locator("canvas[data-shows*='500 points']")).to_be_visible()
    expect(page.locator(".losses svg")).to_be_visible()
    stage(page, 1)
    after = page.evaluate(
        "id => JSON.parse(sessionStorage['mpf.history.' + id]).points.length", job
    )
    assert after > known > 1
    page.get_by_role("button", name="Cancel").click()
    expect(page.locator(".state")).to_have_text("cancelled")


def test_service_restarts_in_the_middle(page: Page, own_service: Served, axe: str) -> None:
    job = begin(page, own_service, **ENDLESS)
    stage(page, 1)
    own_service.stop()
    expect(page.get_by_text("The service does not answer; trying again")).to_be_visible()
    look(page, "lost", axe)
    own_service.start()
    expect(page.get_by_text("The service does not answer")).to_have_count(0)
    wait_for(lambda: own_service.client.get(f"/jobs/{job}").json()["attempt"] == 2, 30, "attempt 2")
    shown = int(page.locator(".stage").get_attribute("data-meshes") or 0)
    stage(page, shown + 1)
    page.get_by_role("button", name="Good enough").click()
    expect(page.get_by_text("Take it home")).to_be_visible(timeout=60_000 * PATIENCE)


def test_upload_goes_on_after_a_restart(page: Page, own_service: Served) -> None:
    page.goto(own_service.url)
    choose_cloud(page, torus())
    fill_in(page, {})
    own_service.stop()
    page.get_by_role("button", name="Reconstruct").click()
    expect(page.get_by_label("Upload", exact=True)).to_contain_text("connection was lost")
    own_service.start()
    page.wait_for_url("**/#/jobs/*")
    assert own_service.ended(page.url.rpartition("/")[2]) == "succeeded"
    expect(page.get_by_text("Take it home")).to_be_visible()


def test_bad_files_are_told_with_advice(page: Page, served: Served, axe: str) -> None:
    page.goto(served.url)
    choose_cloud(page, b"\x89PNG\r\n\x1a\n" + bytes(200), "photo.ply")
    expect(page.get_by_label("The cloud")).to_contain_text("Not shown")
    page.get_by_role("button", name="Reconstruct").click()
    alert = page.get_by_role("alert")
    expect(alert).to_contain_text("input.format_unknown")
    expect(alert.locator(".advice")).not_to_be_empty()
    look(page, "bad-file", axe)
    # What is known beforehand is told beforehand.
    choose_cloud(page, b"0 0 0\n1 1 1\n2 2 3\n", "three.xyz")
    expect(page.get_by_role("alert")).to_contain_text("at least 51")
    expect(page.get_by_role("button", name="Reconstruct")).to_be_disabled()
    # A line of points reads well, and is refused by the service.
    line = "\n".join(f"{k} {k} {k}" for k in range(100)).encode()
    choose_cloud(page, line, "line.xyz")
    expect(page.get_by_role("alert")).to_have_count(0)
    page.get_by_role("button", name="Reconstruct").click()
    expect(page.get_by_role("alert")).to_contain_text("cloud.collinear")


def test_key_is_asked_for_and_kept_for_the_tab(context: BrowserContext, axe: str) -> None:
    with tempfile.TemporaryDirectory(prefix="mpf-") as folder:
        service = Served(Path(folder), MPF_REQUIRE_KEYS="1")
        service.start()
        try:
            url = running_url(service.folder / "data")
            assert url is not None
            _, secret = KeyStore(connect(Settings(redis_url=url))).create("browser")
            _ask_for_a_key(context, service, secret, axe)
        finally:
            service.stop()


def _ask_for_a_key(context: BrowserContext, service: Served, secret: str, axe: str) -> None:
    page = context.new_page()
    wrong = watched(page)
    page.goto(service.url)
    expect(page.get_by_text("This service asks for an API key")).to_be_visible()
    look(page, "key", axe)
    page.get_by_label("Key", exact=True).fill("mpf_wrong")
    page.get_by_role("button", name="Use it").click()
    expect(page.get_by_text("the one given is not valid")).to_be_visible()
    page.get_by_label("Key", exact=True).fill(secret)
    page.get_by_role("button", name="Use it").click()
    expect(page.get_by_text("at least 51")).to_be_visible()
    begin(page, service)
    expect(page.get_by_text("Take it home")).to_be_visible(timeout=60_000 * PATIENCE)
    stage(page, 1)
    page.get_by_label("Show the field here").check()
    expect(page.locator("img.slice")).to_be_visible()
    with page.expect_download() as waiting:
        page.get_by_role("button", name="Report").click()
    assert waiting.value.path().stat().st_size > 1000
    assert page.evaluate("() => localStorage.getItem('mpf.key')") is None
    assert not wrong, wrong


def test_phone(context: BrowserContext, served: Served, finished: str, axe: str) -> None:
    page = context.new_page()
    page.set_viewport_size({"width": 390, "height": 844})
    for name, where in (("new", ""), ("result", f"#/jobs/{finished}"), ("jobs", "#/jobs")):
        page.goto(f"{served.url}/{where}")
        page.reload()
        if name == "result":
            stage(page, 1)
            assert drawn(pixels(page.locator("canvas"))) > 0.05
        wider = page.evaluate("() => document.documentElement.scrollWidth - innerWidth")
        assert wider <= 0, f"{name} is {wider} pixels wider than the phone"
        look(page, f"phone-{name}", axe)


def test_everything_can_be_done_by_keyboard(page: Page, served: Served, finished: str) -> None:
    page.goto(f"{served.url}/#/jobs/{finished}")
    stage(page, 1)
    expect(page.get_by_text("Clip the view here")).to_be_visible()  # comes with the slices
    reached: set[str] = set()
    for _ in range(60):
        page.keyboard.press("Tab")
        reached.add(
            page.evaluate(
                "() => (document.activeElement.ariaLabel || document.activeElement.innerText"
                " || document.activeElement.labels?.[0]?.innerText || '').trim()"
            )
        )
    told = "\n".join(reached)
    for name in (
        "Jobs", "Surface", "Distance to the input", "Clip the view here", "Position",
        "Surface for viewers", "Take the surface again", "Make a link", "Arrow keys",
    ):  # fmt: skip
        assert name in told, f"{name} is not reached by Tab: {told}"


def test_long_polls_take_over_where_events_do_not_come_through(page: Page, served: Served) -> None:
    """As behind a proxy that breaks every stream."""
    page.route("**/events", lambda route: route.abort())
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))

    def polls() -> list[str]:
        page.wait_for_timeout(200)  # lets Playwright tell of requests
        return [url for url in asked if "wait=" in url]

    job = begin(page, served, **ENDLESS)
    wait_for(polls, 60 * PATIENCE, "a long poll")
    assert job in polls()[0]
    page.get_by_role("button", name="Cancel").click()
    expect(page.locator(".state")).to_have_text("cancelled", timeout=30_000 * PATIENCE)
