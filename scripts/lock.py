"""Writes constraints.txt: the versions in this environment of everything the project needs.

    .venv/bin/python scripts/lock.py

Run it after the environment was brought up to date and the tests have passed there. Only what the
project, its extras and its build reach is written, so that tools installed by hand stay out.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path

from packaging.requirements import Requirement
from packaging.version import Version

ROOT = Path(__file__).resolve().parent.parent
PROJECT = "metric-phase-fields[fit,bench,dev]"
BUILD = ("hatchling", "editables")
HEADER = """\
# Versions that the tests have passed with, for scripts/setup; written by scripts/lock.py.
# They hold on Python 3.11, 3.12 and 3.13. A constraint installs nothing by itself.
"""


def locked(wanted: Iterable[str]) -> dict[str, str]:
    """Name and version of every installed package that `wanted` reach."""
    found: dict[str, str] = {}
    seen: set[tuple[str, str]] = set()
    queue = [(Requirement(text), "") for text in wanted]
    while queue:
        requirement, extra = queue.pop()
        if requirement.marker is not None and not requirement.marker.evaluate({"extra": extra}):
            continue
        name = canonical(requirement.name)
        for asked in ("", *requirement.extras):
            if (name, asked) in seen:
                continue
            seen.add((name, asked))
            try:
                found[name] = Version(version(name)).public
            except PackageNotFoundError:
                continue
            queue += [(Requirement(text), asked) for text in requires(name) or ()]
    return found


def canonical(name: str) -> str:
    """The one spelling of a package's name."""
    return re.sub(r"[-_.]+", "-", name).lower()


def main() -> None:
    """Write the file."""
    versions = locked([PROJECT, *BUILD])
    del versions[canonical(Requirement(PROJECT).name)]
    lines = [f"{name}=={versions[name]}\n" for name in sorted(versions)]
    (ROOT / "constraints.txt").write_text(HEADER + "".join(lines))


if __name__ == "__main__":
    main()
