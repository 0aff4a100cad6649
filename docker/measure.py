#!/usr/bin/env python3
"""Runs the steps of docker/Dockerfile in a clean root, without Docker, and tells the sizes.

    python docker/measure.py                as root, with debootstrap and the indexes of pip and apt
    python docker/measure.py --keep FOLDER   leave the root there

The steps are read from the Dockerfile: those between `#: name` and `#:`. What differs is what they
begin from: Debian 12 by debootstrap, with its own Python, instead of Docker's image of Python.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parent.parent
PACKAGES = "python3,python3-venv,python3-pip,ca-certificates"
MEGABYTE = 1e6

FIT = """
from pathlib import Path
import numpy as np
from mpf_core.options import options_from
from mpf_core.results import reconstruct_file
points = np.random.default_rng(0).normal(size=(2000, 3))
cloud = Path("/tmp/sphere.xyz")
np.savetxt(cloud, points / np.linalg.norm(points, axis=1, keepdims=True))
small = {"preset": "draft", "max_iterations": 300, "resolution": 32, "time_budget": 900.0}
report = reconstruct_file(cloud, Path("/tmp/sphere"), options_from(small))
assert report["fit"]["loops"] == "fused", report["fit"]
assert report["surface"]["watertight"], report["surface"]
"""
"""A surface of a sphere, by the packages as they are in the image."""


def steps() -> dict[str, str]:
    """The shell commands of the Dockerfile's marked steps by name."""
    text = (REPOSITORY / "docker" / "Dockerfile").read_text()
    found = {}
    for name, body in re.findall(r"^#: (\S+)\n(.*?)^#:$", text, re.MULTILINE | re.DOTALL):
        lines = [line for line in body.splitlines() if not line.startswith("#")]
        found[name] = "\n".join(lines).removeprefix("RUN ")
    return found


def told(text: str) -> None:
    """A line at once."""
    print(f"measure: {text}", flush=True)


def size(*folders: Path) -> float:
    """What the folders take, MB."""
    command = ["du", "--summarize", "--block-size=1", "--one-file-system", *map(str, folders)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return sum(int(line.split()[0]) for line in done.stdout.splitlines()) / MEGABYTE


@contextmanager
def mounted(root: Path) -> Iterator[None]:
    """/proc and /dev inside, as a container has them."""
    for name in ("proc", "dev"):
        subprocess.run(["mount", "--rbind", f"/{name}", str(root / name)], check=True)
        subprocess.run(["mount", "--make-rslave", str(root / name)], check=True)
    try:
        yield
    finally:
        for name in ("dev", "proc"):
            subprocess.run(["umount", "--recursive", "--lazy", str(root / name)], check=False)


def run(root: Path, name: str, command: str) -> None:
    """One step, in `root`."""
    begin = time.monotonic()
    environment = {
        "PATH": "/usr/local/bin:/usr/bin:/bin:/usr/sbin:/sbin",
        "HOME": "/root",
        "PIP_CONSTRAINT": "/tmp/constraints.txt" if name != "wheel" else "",
        "PIP_ROOT_USER_ACTION": "ignore",
        "PIP_DISABLE_PIP_VERSION_CHECK": "1",
        "PYTHONDONTWRITEBYTECODE": "1",
    } | {key: value for key, value in os.environ.items()
         if key.startswith(("PIP_", "NPM_", "NODE_"))
         or key.lower() in ("http_proxy", "https_proxy", "no_proxy")}  # fmt: skip
    where = "/src" if name == "wheel" else "/"
    subprocess.run(
        ["chroot", str(root), "sh", "-euc", f"cd {where}\n{command}"], check=True, env=environment
    )
    told(f"{name}: {time.monotonic() - begin:.0f} s")


def prepare(root: Path) -> None:
    """A clean Debian, the sources that the Dockerfile copies, this machine's package indexes."""
    subprocess.run(
        ["debootstrap", "--variant=minbase", f"--include={PACKAGES}", "bookworm", str(root)],
        check=True, stdout=subprocess.DEVNULL,
    )  # fmt: skip
    (root / "usr/local/bin/python").symlink_to("/usr/bin/python3")
    archive = subprocess.run(
        ["git", "-C", str(REPOSITORY), "ls-files", "-z"], check=True, capture_output=True
    ).stdout.decode()
    wanted = ("mpf_core/", "service/", "worker/", "openapi/", "pyproject.toml", "README.md",
              "LICENSE", "constraints.txt", "scripts/web.py")  # fmt: skip
    for name in filter(None, archive.split("\0")):
        if name.startswith(wanted):
            target = root / "src" / name
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(REPOSITORY / name, target)
    shutil.copy2(REPOSITORY / "constraints.txt", root / "tmp/constraints.txt")
    for path in ("/etc/pip.conf", "/etc/resolv.conf", "/etc/hosts",
                 "/etc/ssl/certs/ca-certificates.crt", "/root/.npmrc",
                 "/root/.config/pip/pip.conf", "/root/.pip/pip.conf"):  # fmt: skip
        if Path(path).exists():
            target = root / path.lstrip("/")
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, target)
    for folder in os.environ.get("PIP_FIND_LINKS", "").split():
        if Path(folder).is_dir():
            shutil.copytree(folder, root / folder.lstrip("/"))


def measure(root: Path) -> dict[str, float]:
    """Build both images' folders; their sizes, MB."""
    found = steps()
    root.mkdir(parents=True, exist_ok=True)
    root.chmod(0o755)  # the image's user starts there
    prepare(root)
    sizes = {}
    with mounted(root):
        run(root, "wheel", found["wheel"])
        run(root, "runtime", found["runtime"])
        system = size(*(root / name for name in ("usr", "etc", "var", "lib", "bin", "sbin")
                        if (root / name).exists() and not (root / name).is_symlink()))  # fmt: skip
        run(root, "api-packages", found["api-packages"])
        sizes["system"] = system
        sizes["packages of the API"] = size(root / "opt/mpf")
        check(root, "import service.app, sys; assert 'torch' not in sys.modules")
        # Where git is not, its list of what to ignore is not either.
        check(root, "import service.web as w; from pathlib import Path; "
                    "assert not (Path(w.__path__[0]) / 'node_modules').exists()")  # fmt: skip
        check(root, "import importlib.util as u; assert u.find_spec('torch') is None")
        run(root, "worker-packages", found["worker-packages"])
        sizes["packages of the worker"] = size(root / "opt/mpf")
        check(root, "import worker.main, sys; assert 'torch' not in sys.modules")
        check(root, FIT)
    return sizes


def check(root: Path, code: str) -> None:
    """Run Python as the image's user, who may write nowhere."""
    subprocess.run(
        ["chroot", "--userspec=10001:10001", str(root), "/opt/mpf/bin/python", "-c", code],
        check=True,
        env={"PATH": "/opt/mpf/bin:/usr/sbin:/usr/bin", "MPLCONFIGDIR": "/tmp", "HOME": "/data"},
    )


def main() -> None:
    """Measure and tell."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--keep", type=Path, help="folder for the root, which stays")
    given = parser.parse_args()
    if os.geteuid() or not shutil.which("debootstrap"):
        sys.exit("measure: this needs root and debootstrap (apt-get install debootstrap)")
    folder = given.keep or Path(tempfile.mkdtemp(prefix="mpf-root-"))
    try:
        for name, megabytes in measure(folder).items():
            told(f"{name}: {megabytes:.0f} MB")
    finally:
        if given.keep is None:
            shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    main()
