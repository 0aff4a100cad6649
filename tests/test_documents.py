"""The documents speak of files that are there."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from mpf_core.options import PRESETS

ROOT = Path(__file__).resolve().parents[1]
DOCUMENTS = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])

# Where ARCHITECTURE.md speaks of each package.
SECTIONS = {"mpf_core": "## mpf_core", "service": "## service", "worker": "## worker"}


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda d: str(d.relative_to(ROOT)))
def test_links_lead_to_files(document: Path) -> None:
    for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", document.read_text()):
        if "://" not in target:
            assert (document.parent / target).exists(), f"{document.name} links to {target}"


def named(package: str) -> Iterator[Path]:
    """The files that the section of `package` names."""
    text = (ROOT / "ARCHITECTURE.md").read_text()
    section = text.split(f"\n{SECTIONS[package]}", 1)[1].split("\n## ", 1)[0]
    for line in section.splitlines():
        if not line.startswith("|"):
            if package == "worker":
                yield from (ROOT / package / name for name in re.findall(r"`(\w+\.py)`", line))
            continue
        room = re.match(r"\| `(\w+)/`", line)
        folder = ROOT / package / (room.group(1) if room else "")
        yield from (folder / name for name in re.findall(r"`(\w+\.py)`", line))


@pytest.mark.parametrize("package", SECTIONS)
def test_the_architecture_names_files_that_exist(package: str) -> None:
    files = list(named(package))
    assert len(files) > 5
    assert not [str(file.relative_to(ROOT)) for file in files if not file.is_file()]


@pytest.mark.parametrize("package", SECTIONS)
def test_the_architecture_names_every_room(package: str) -> None:
    text = (ROOT / "ARCHITECTURE.md").read_text()
    rooms = [f.parent.name for f in (ROOT / package).glob("*/__init__.py")]
    assert not [room for room in rooms if f"`{room}/`" not in text]


def test_the_readme_tells_the_presets_as_they_are() -> None:
    told = re.findall(
        r"^\| `(\w+)` \| ([\d ]+) \| (.+?) \|", (ROOT / "README.md").read_text(), re.M
    )
    found = {name: (int(steps.replace(" ", "")), time) for name, steps, time in told}
    assert found.keys() == PRESETS.keys()
    for name, (steps, time) in found.items():
        fit = PRESETS[name].fit
        assert steps == fit.max_iterations
        assert time == ("a week" if fit.time_budget == 7 * 86_400 else f"{fit.time_budget:g} s")
