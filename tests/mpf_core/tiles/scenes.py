"""Small clouds in two tiles, split, fitted and joined once for all tests."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np
import pytest

from mpf_core import options_from
from mpf_core.cloud.pointcloud import PointCloud
from mpf_core.field import artefact
from mpf_core.field.blend import BlendedField
from mpf_core.field.blendfile import load_field
from mpf_core.field.fitted import FittedField
from mpf_core.options import Options
from mpf_core.surface.export import cloud_ply_bytes
from mpf_core.tiles import fit_tile_file, join_files, read_plan, split_file
from mpf_core.tiles.plan import Plan
from tests.mpf_core.clouds import Array, plane, sphere

POOL = 20_000  # most of a tiny fit's time would go into pools that it hardly draws from
SMALL: dict[str, Any] = {
    "width": 64,
    "omega": 5.0,
    "max_iterations": 100,
    "resolution": 48,
    "slices": 0,
    "threads": 1,
    "time_budget": 86_400.0,
    "surface_points": 256,
    "near_points": 256,
    "far_points": 256,
    "start_points": 1024,
    "tile_points": 1100,
}
LONGER: dict[str, Any] = {"max_iterations": 300, "omega": 15.0, "start_points": 2048}


def small(**changes: Any) -> Options:
    return options_from(SMALL | changes)


def write_cloud(points: Array, path: Path) -> Path:
    path.write_bytes(cloud_ply_bytes(PointCloud(points), []))
    return path


@dataclass(frozen=True)
class Scene:
    """A cloud with all that came of it."""

    points: Array
    cloud: Path
    plan_dir: Path
    fields: tuple[Path, ...]
    out: Path
    report: dict[str, Any]

    @property
    def plan(self) -> Plan:
        return read_plan(self.plan_dir)

    @property
    def blend(self) -> BlendedField:
        found = load_field(self.out / "field.safetensors")
        assert isinstance(found, BlendedField)
        return found

    @property
    def tiles(self) -> list[FittedField]:
        return [artefact.load_field(path) for path in self.fields]


def made(points: Array, **changes: Any) -> Scene:
    """Split, fitted, joined in a folder of its own."""
    base = Path(mkdtemp(prefix="mpf-test-tiles-"))
    cloud, options = write_cloud(points, base / "cloud.ply"), small(**changes)
    plan = split_file(cloud, base / "plan", options)
    fields = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mpf_core.fit.sampler.pool_size", lambda _: POOL)
        for index, name in enumerate(plan.files):
            fit_tile_file(base / "plan" / name, base / str(index), options)
            fields.append(base / str(index) / "field.safetensors")
    report = join_files(base / "plan", fields, cloud, base / "out", options)
    return Scene(points, cloud, base / "plan", tuple(fields), base / "out", report)


@cache
def ball() -> Scene:
    """A sphere of radius 3 about (5, 0, 0): a solid, of which each tile sees an open half."""
    return made(sphere(2000, 3.0) + np.array([5.0, 0, 0]))


@cache
def sheet() -> Scene:
    """A tilted plane of side 4: an open sheet, whose sides nothing but the whole can agree on."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mpf_core.tiles.split.THINNEST", 0.03)  # a shell that a tiny fit can hold
        patch.setattr("mpf_core.tiles.join.PADDING", 0.15)  # and room for it at the rim
        return made(2 * plane(45, tilt=0.3), fidelity="off", resolution=96, **LONGER)


SCENES: dict[str, Callable[[], Scene]] = {"ball": ball, "sheet": sheet}
