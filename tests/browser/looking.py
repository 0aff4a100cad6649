"""What is seen: pictures of every state in both themes, and what axe-core says of them."""

from __future__ import annotations

import io
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from playwright.sync_api import Locator, Page

from tests.services import REPOSITORY, wait_for

PICTURES = Path(os.environ.get("MPF_PICTURES", REPOSITORY / "out" / "browser"))
THEMES = ("light", "dark")
RULES = {"runOnly": ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"]}


def look(page: Page, name: str, axe: str) -> None:
    """Keep a picture of the page in both themes; it must be without axe-core's violations."""
    PICTURES.mkdir(parents=True, exist_ok=True)
    for theme in THEMES:
        page.emulate_media(color_scheme=theme)
        page.wait_for_timeout(300)
        page.screenshot(path=PICTURES / f"{name}-{theme}.png")
        page.evaluate(axe)
        found = page.evaluate("rules => axe.run(document, rules)", RULES)
        told = [
            f"{one['id']}: {node['html'][:200]} {node['failureSummary']}"
            for one in found["violations"]
            for node in one["nodes"]
        ]
        assert not told, f"{name} in {theme}: " + "\n".join(told)


def pixels(canvas: Locator) -> NDArray[np.uint8]:
    """(h, w, 3) what a canvas shows."""
    return np.asarray(Image.open(io.BytesIO(canvas.screenshot())).convert("RGB"))


def drawn(picture: NDArray[np.uint8]) -> float:
    """Share of the pixels that differ from the background, whose colour is that of a corner."""
    far = np.abs(picture.astype(int) - picture[-3, 3].astype(int)).max(axis=2) > 12
    return float(far.mean())


def changed(canvas: Locator, before: NDArray[np.uint8], act: Callable[[], None]) -> None:
    """Fails unless what `act` does is seen in the canvas."""
    act()
    wait_for(
        lambda: bool((np.abs(pixels(canvas).astype(int) - before) > 12).any(axis=2).sum() > 50),
        10, "a change of the picture",
    )  # fmt: skip
