"""Simulated scans against the exact surface, and the command that writes them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from plyfile import PlyData

from mpf_core.cloud.reader import read_cloud
from mpf_core.errors import OptionsError
from mpf_core.experiments.cli import sample
from mpf_core.experiments.samples import DEFAULT, SAMPLES, make_sample
from mpf_core.experiments.scanning import Viewpoint, ring, scan
from mpf_core.experiments.shapes import shape
from mpf_core.quality.meshio import read_mesh
from mpf_core.quality.metrics import point_distances, points_to_surface

SIMULATED = [name for name, made in SAMPLES.items() if made.truth is not None]


@pytest.mark.parametrize("name", SIMULATED)
def test_points_lie_about_the_exact_surface(name: str) -> None:
    cloud, truth = make_sample(name, 1500, seed=1), SAMPLES[name].truth
    assert len(cloud) == 1500
    assert truth is not None
    found = points_to_surface(cloud.points, truth())
    longest = np.ptp(truth().vertices, axis=0).max()
    assert 0 < found.median < 2e-3 * longest
    assert found.max < 2e-2 * longest
    again = make_sample(name, 1500, seed=1)
    assert np.array_equal(cloud.points, again.points)


def test_a_scanner_sees_one_side_only() -> None:
    cloud = scan(shape("sphere"), (Viewpoint((4, 0, 0)),), 2000, noise=0.0)
    assert cloud.points[:, 0].min() > 0.25
    assert point_distances(cloud.points, shape("sphere")).max() < 1e-6


def test_what_is_behind_is_not_seen() -> None:
    cloud = scan(shape("nested-shells"), ring(4, 20), 2000, noise=0.0)
    assert np.linalg.norm(cloud.points, axis=1).min() > 0.99


def test_noise_is_along_the_ray() -> None:
    above = (Viewpoint((0, 0, 50), cone=1.5),)
    cloud = scan(shape("sheet"), above, 5000, noise=0.01)
    assert cloud.points[:, 2].std() == pytest.approx(0.01, rel=0.05)


def test_the_fault_is_in_metres() -> None:
    cloud = make_sample("jacksboro-fault")
    assert len(cloud) == 138_632
    width, height, relief = np.ptp(cloud.points, axis=0)
    # 0.335° of longitude at 36.6° N, 0.286° of latitude.
    assert width == pytest.approx(29_960, rel=2e-3)
    assert height == pytest.approx(31_720, rel=2e-3)
    assert relief == 840
    assert len(make_sample("jacksboro-fault", 1000, seed=2)) == 1000


def test_command_writes_cloud_and_truth(tmp_path: Path) -> None:
    out, truth = tmp_path / "cloud.ply", tmp_path / "truth.ply"
    arguments = ["-o", str(out), "--points", "2000", "--truth", str(truth)]
    told = CliRunner().invoke(sample, arguments)
    assert told.exit_code == 0, told.output
    ply = PlyData.read(out)
    assert not ply.text
    assert ply.byte_order == "<"
    assert ply["vertex"]["x"].dtype == np.float64
    cloud = read_cloud(out)
    assert len(cloud) == 2000
    assert cloud.colors is not None
    assert points_to_surface(cloud.points, read_mesh(truth)).median < 1e-3
    assert DEFAULT in ply.comments[0]


def test_command_lists_and_refuses(tmp_path: Path) -> None:
    run = CliRunner().invoke
    assert all(name in run(sample, ["--list"]).output for name in SAMPLES)
    assert run(sample, ["teapot", "-o", str(tmp_path / "a.ply")]).exit_code == 2
    assert run(sample, []).exit_code == 2
    real = ["jacksboro-fault", "-o", str(tmp_path / "a.ply"), "--truth", str(tmp_path / "b.ply")]
    assert run(sample, real).exit_code == 2
    assert list(tmp_path.iterdir()) == []
    nowhere = run(sample, ["-o", str(tmp_path / "no" / "a.ply"), "--points", "100"])
    assert nowhere.exit_code == 1
    assert "Traceback" not in nowhere.output
    with pytest.raises(OptionsError):
        make_sample("teapot")
