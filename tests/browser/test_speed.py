"""How soon the page is there, and that it stays with its user; `pytest -rP` tells the figures."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Page, expect

from tests.browser.served import Served
from tests.services import PATIENCE, tell, wait_for

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]

PAINTED = """() => {
  const first = performance.getEntriesByName('first-contentful-paint')[0];
  const [navigation] = performance.getEntriesByType('navigation');
  const scripts = performance.getEntriesByType('resource').filter((r) => r.name.endsWith('.js'));
  return {
    paint: first?.startTime ?? null,
    usable: navigation.domContentLoadedEventEnd,
    scripts: scripts.reduce((sum, one) => sum + one.transferSize, 0),
  };
}"""


def painted(page: Page) -> dict[str, Any] | None:
    found: dict[str, Any] = page.evaluate(PAINTED)
    return found if found["paint"] is not None else None


def test_the_page_is_there_within_a_second(page: Page, served: Served) -> None:
    found = []
    for _ in range(5):
        page.goto("about:blank")
        page.goto(served.url)
        expect(page.get_by_text("at least 51")).to_be_visible()
        # The entry comes some frames after the paint that it tells of.
        found.append(wait_for(lambda: painted(page), 10, "first paint"))
    first, paints = found[0], sorted(one["paint"] for one in found)
    tell(f"first paint {first['paint']:.0f} ms without a cache, median {paints[2]:.0f} ms; "
         f"usable {first['usable']:.0f} ms; scripts {first['scripts'] / 1000:.0f} kB")  # fmt: skip
    assert paints[2] < 1000 * PATIENCE


def test_three_million_points_do_not_freeze_the_page(page: Page, served: Served) -> None:
    points = np.random.default_rng(0).normal(size=(3_000_000, 3)).astype("<f4")
    header = (
        b"ply\nformat binary_little_endian 1.0\nelement vertex 3000000\n"
        b"property float x\nproperty float y\nproperty float z\nend_header\n"
    )
    path = served.folder / "large.ply"
    path.write_bytes(header + points.tobytes())
    page.goto(served.url)
    # The longest time in which the page could not have answered anybody.
    page.evaluate(
        "() => { window.worst = 0; let last = performance.now(); setInterval(() => {"
        " const now = performance.now(); window.worst = Math.max(window.worst, now - last);"
        " last = now; }, 20); }"
    )
    page.set_input_files("input[type=file]", path)
    facts = page.get_by_label("The cloud")
    expect(facts).to_contain_text("3,000,000", timeout=60_000 * PATIENCE)
    expect(facts).to_contain_text("500,000 of 3,000,000 points are drawn")
    expect(page.locator("canvas[data-shows*='500,000 points']")).to_be_visible()
    worst = page.evaluate("() => window.worst")
    tell(f"longest pause of the page: {worst:.0f} ms")
    assert worst < 1000 * PATIENCE
