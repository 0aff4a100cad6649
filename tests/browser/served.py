"""`mpf serve` at a port that stays, so that a page finds it again after a restart."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import httpx2
import numpy as np

from tests.services import REPOSITORY, stop, wait_for

TINY: dict[str, Any] = {
    "preset": "draft", "max_iterations": 60, "time_budget": 600.0, "width": 32, "omega": 10,
    "resolution": 40, "slices": 3,
    "surface_points": 256, "near_points": 256, "far_points": 256, "start_points": 256,
}  # fmt: skip
"""A fit of a second, on a machine that has one to spare."""


def torus(count: int = 500, seed: int = 0) -> bytes:
    """Rows of a coloured torus, with a header."""
    u, v = np.random.default_rng(seed).uniform(0, 2 * np.pi, (2, count))
    ring = 1 + 0.4 * np.cos(v)
    points = np.stack([ring * np.cos(u), ring * np.sin(u), 0.4 * np.sin(v)], axis=1)
    colors = 127.5 + 127 * np.stack([np.cos(u), np.cos(u + 2), np.cos(v)], axis=1)
    rows = [
        " ".join(f"{value:.6f}" for value in p) + " " + " ".join(f"{value:.0f}" for value in c)
        for p, c in zip(points, colors, strict=True)
    ]
    return "\n".join(["x y z red green blue", *rows, ""]).encode()


class Served:
    """A service that can be stopped and started again over the same folder and port."""

    def __init__(self, folder: Path, **settings: str):
        self.folder = folder
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = probe.getsockname()[1]
        self.url = f"http://127.0.0.1:{self.port}"
        self._settings = {"MPF_JOB_NICE": "0", "MPF_PROGRESS_SECONDS": "0.1"} | settings
        self._process: subprocess.Popen[bytes] | None = None
        self.client = httpx2.Client(base_url=self.url, timeout=120)

    def start(self) -> None:
        command = [sys.executable, "-m", "mpf_core", "serve", "--port", str(self.port)]
        environment = os.environ | self._settings | {"PYTHONPATH": str(REPOSITORY)}
        with (self.folder / "log").open("ab") as log:
            self._process = subprocess.Popen(
                [*command, "--data-dir", str(self.folder / "data")], stderr=log, env=environment
            )
        wait_for(self._ready, 40, "mpf serve")

    def stop(self) -> None:
        if self._process is not None:
            stop(self._process)

    def _ready(self) -> bool:
        try:
            return str(self.client.get("/readyz").json()["status"]) == "ready"
        except httpx2.HTTPError:
            return False

    def fitted(self, cloud: bytes, **options: Any) -> str:
        """The id of a job that has succeeded."""
        answer = self.client.post(
            "/jobs",
            files={"file": ("torus.xyz", cloud)},
            data={"options": json.dumps(TINY | options)},
        )
        assert answer.status_code == 202, answer.text
        job_id = str(answer.json()["id"])
        assert self.ended(job_id) == "succeeded"
        return job_id

    def ended(self, job_id: str) -> str:
        def state() -> str | None:
            found = str(self.client.get(f"/jobs/{job_id}", params={"wait": 10}).json()["state"])
            return None if found in ("queued", "running") else found

        return wait_for(state, 120, f"the end of {job_id}")
