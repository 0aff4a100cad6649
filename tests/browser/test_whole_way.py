"""From a file to a mesh at home, as somebody does it who never sees curl."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import trimesh
from playwright.sync_api import Page, expect

from tests.browser.looking import changed, drawn, look, pixels
from tests.browser.served import TINY, Served, torus
from tests.services import PATIENCE, wait_for

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]

ENDLESS = {"max iterations": "200000", "time budget": "100000"}


def choose_cloud(page: Page, cloud: bytes, name: str = "torus.xyz") -> None:
    page.set_input_files(
        "input[type=file]", {"name": name, "mimeType": "text/plain", "buffer": cloud}
    )


def fill_in(page: Page, changes: dict[str, str]) -> None:
    """Options of a fit that is small, but for those in `changes`."""
    page.get_by_text("More options").click()
    page.get_by_text("For experts").click()
    wanted = {name.replace("_", " "): str(value) for name, value in TINY.items()} | changes
    wanted["most iterations"] = wanted.pop("max iterations")
    page.get_by_label(wanted.pop("preset")).check()
    for label, value in wanted.items():
        page.get_by_label(label, exact=False).first.fill(value)


def begin(page: Page, served: Served, **changes: str) -> str:
    """Upload a torus and start its fit; the id of the job."""
    page.goto(served.url)
    choose_cloud(page, torus())
    expect(page.get_by_label("The cloud")).to_contain_text("500, with colours")
    fill_in(page, changes)
    page.get_by_role("button", name="Reconstruct").click()
    page.wait_for_url("**/#/jobs/*")
    return page.url.rpartition("/")[2]


def stage(page: Page, meshes: int) -> None:
    """Wait until so many meshes have been shown."""
    wait_for(
        lambda: int(page.locator(".stage").get_attribute("data-meshes") or 0) >= meshes,
        60, f"{meshes} meshes",
    )  # fmt: skip


def test_upload_watch_stop_and_take_home(
    page: Page, served: Served, axe: str, tmp_path: Path
) -> None:
    page.goto(served.url)
    expect(page.get_by_text("Up to")).to_contain_text("at least 51")
    look(page, "new", axe)
    canvas = page.locator("canvas")
    begin(page, served, **ENDLESS)
    assert drawn(pixels(canvas)) > 0.01, "the points are to be seen while the job waits"

    stage(page, 1)
    first = pixels(canvas)
    assert drawn(first) > 0.05
    expect(page.get_by_label("Progress")).to_contain_text("Fitting the field")
    expect(page.locator(".losses svg")).to_be_visible()
    look(page, "running", axe)
    stage(page, 2)
    changed(canvas, first, lambda: None)

    page.get_by_role("button", name="Good enough").click()
    expect(page.get_by_text("Take it home")).to_be_visible(timeout=60_000 * PATIENCE)
    expect(page.locator("canvas")).to_have_attribute("data-shows", re.compile("triangles"))
    page.get_by_label("Points", exact=True).uncheck()
    assert drawn(pixels(canvas)) > 0.05
    expect(page.locator(".headline")).to_contain_text("component")
    expect(page.locator(".words")).to_contain_text("good enough")

    with page.expect_download() as waiting:
        page.get_by_role("button", name="Surface for viewers").click()
    target = tmp_path / "mesh.glb"
    waiting.value.save_as(target)
    mesh = trimesh.load(target, force="mesh")
    assert len(mesh.faces) > 500
    assert len(mesh.vertices) > 250
    assert (mesh.extents > [2.4, 2.4, 0.5]).all() and (mesh.extents < 4).all()

    # From now on the service knows how fast it fits, and the page tells.
    assert served.client.get("/capabilities").json()["rate"]["points_per_second"] > 0
    page.goto(served.url)
    choose_cloud(page, torus())
    expect(page.locator(".presets")).to_contain_text("at this server’s speed")


def test_result_is_looked_at_from_all_sides(
    page: Page, served: Served, finished: str, axe: str
) -> None:
    page.goto(f"{served.url}/#/jobs/{finished}")
    stage(page, 1)
    canvas = page.locator("canvas")
    expect(page.locator(".headline")).to_contain_text("median distance")
    look(page, "result", axe)

    changed(canvas, pixels(canvas), lambda: page.get_by_label("Edges").check())
    changed(canvas, pixels(canvas), lambda: page.get_by_label("Distance to the input").check())
    expect(page.locator(".legend")).to_contain_text("nearest input point")
    look(page, "distances", axe)
    page.get_by_label("Distance to the input").uncheck()
    changed(canvas, pixels(canvas), lambda: page.get_by_label("Clip the view here").check())
    changed(canvas, pixels(canvas), lambda: page.get_by_label("Show the field here").check())
    expect(page.locator("img.slice")).to_have_attribute("alt", re.compile("^phi on the plane y"))
    before = pixels(canvas)
    changed(canvas, before, lambda: page.get_by_label("Position").press("ArrowRight"))
    look(page, "slice", axe)

    canvas.focus()
    changed(canvas, pixels(canvas), lambda: page.keyboard.press("ArrowLeft"))

    # Another field is drawn when it is asked for, once.
    page.get_by_label("Field", exact=False).last.select_option("r")
    expect(page.locator("img.slice")).to_have_attribute(
        "alt", re.compile("^r on the plane y"), timeout=60_000 * PATIENCE
    )
    label = f"slices of r for {finished}"
    assert len(served.client.get("/jobs", params={"label": label}).json()["jobs"]) == 1


def test_again_at_another_resolution_and_shared(
    page: Page, served: Served, finished: str, axe: str
) -> None:
    page.goto(f"{served.url}/#/jobs/{finished}")
    page.get_by_label("Cells along the longest side").fill("64")
    page.get_by_role("button", name="Take the surface again").click()
    page.wait_for_url(lambda url: not url.endswith(finished))
    expect(page.get_by_text("Take it home")).to_be_visible(timeout=60_000 * PATIENCE)
    stage(page, 1)
    page.get_by_role("button", name="Make a link").click()
    link = page.get_by_label("Anybody with this link").input_value()
    assert "/#/shared/" in link

    assert page.context.browser is not None
    stranger = page.context.browser.new_page()
    stranger.goto(link)
    expect(stranger.locator(".headline")).to_contain_text("component")
    stage(stranger, 1)
    assert drawn(pixels(stranger.locator("canvas"))) > 0.05
    expect(stranger.get_by_role("button", name="Take the surface again")).to_have_count(0)
    look(stranger, "shared", axe)
    page.get_by_role("button", name="End it").click()
    expect(page.get_by_role("button", name="Make a link")).to_be_visible()
    stranger.reload()
    expect(stranger.get_by_role("alert")).to_contain_text("There is no such share")
    stranger.close()


def test_jobs_are_listed_tried_again_and_deleted(page: Page, served: Served, axe: str) -> None:
    job = served.fitted(torus(seed=1))
    page.goto(f"{served.url}/#/jobs")
    row = page.locator("li", has=page.locator(f'a[href="#/jobs/{job}"]'))
    expect(row).to_contain_text("succeeded")
    expect(row.locator("img")).to_be_visible()
    look(page, "jobs", axe)
    row.get_by_role("button", name="Retry").click()
    page.wait_for_url(lambda url: "#/jobs/" in url)
    repeated = page.url.rpartition("/")[2]
    assert repeated != job
    assert served.client.get(f"/jobs/{repeated}").json()["parent"] == job
    page.goto(f"{served.url}/#/jobs")
    row.get_by_role("button", name="Delete").click()
    row.get_by_role("button", name="Really delete").click()
    expect(row).to_have_count(0)
    assert served.client.get(f"/jobs/{job}").status_code == 404
