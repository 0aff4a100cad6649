"""Plans and tiles as files: the same every time, and nothing else gets in."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from safetensors.numpy import load, save

from mpf_core.cloud.reader import read_cloud
from mpf_core.errors import TileFormat, TileVersion
from mpf_core.options import options_from
from mpf_core.tiles import join_files, read_plan, split_file, tile_count
from mpf_core.tiles.join import tiles_report
from mpf_core.tiles.patchfile import read_patches
from mpf_core.tiles.plan import TILE_ENTRY, read_tile, tile_bytes
from tests.mpf_core.tiles.scenes import ball, small


@pytest.mark.parametrize(
    ("points", "changes", "count"),
    [
        (51, {}, 1),
        (400_000, {}, 1),
        (400_001, {}, 2),
        (3_000_000, {}, 8),
        (3_000_000, {"tiles": "off"}, 1),
        (3_000_000, {"preset": "paper"}, 1),
        (3_000_000, {"tile_points": 1_000_000}, 3),
        (10_000_000, {"tile_points": 100}, 256),
    ],
)
def test_how_many_tiles(points: int, changes: dict[str, object], count: int) -> None:
    assert tile_count(points, options_from(changes)) == count


def test_the_same_cloud_gives_the_same_bytes(tmp_path: Path) -> None:
    scene = ball()
    split_file(scene.cloud, tmp_path, small())
    names = sorted(path.name for path in scene.plan_dir.iterdir())
    assert names == sorted(path.name for path in tmp_path.iterdir())
    assert names == [
        "plan.json",
        "side.safetensors",
        "tile-000.safetensors",
        "tile-001.safetensors",
    ]
    for name in names:
        assert (tmp_path / name).read_bytes() == (scene.plan_dir / name).read_bytes()


def test_every_sample_is_in_a_tile_with_all_around_it() -> None:
    scene = ball()
    tiles = [read_tile(scene.plan_dir / name) for name in scene.plan.files]
    assert [len(tile.points) for tile in tiles] == list(scene.plan.samples)
    assert 2000 < sum(scene.plan.samples) < 3900
    both = np.unique(np.concatenate([tile.points for tile in tiles]), axis=0)
    assert np.array_equal(both, np.unique(read_cloud(scene.cloud).points, axis=0))
    for tile in tiles:
        inside = ((scene.points >= tile.support[0]) & (scene.points <= tile.support[1])).all(1)
        assert inside.sum() < len(tile.points)
        own = tile.similarity.to_normalised(tile.points)
        assert np.abs(own).max() <= 1
    assert tiles[0].phase.shell / tiles[0].similarity.scale == pytest.approx(scene.plan.shell)


def test_a_tile_comes_back_bit_for_bit() -> None:
    path = ball().plan_dir / "tile-001.safetensors"
    assert tile_bytes(read_tile(path)) == path.read_bytes()


def test_damaged_tiles_are_refused(tmp_path: Path) -> None:
    content = (ball().plan_dir / "tile-000.safetensors").read_bytes()
    size = int.from_bytes(content[:8], "little")
    about = json.loads(content[8 : 8 + size])["__metadata__"]
    tensors, path = load(content), tmp_path / "tile-000.safetensors"
    bad = tensors["points"].copy()
    bad[0, 0] = np.nan
    telling = json.loads(about[TILE_ENTRY])
    turned = telling["support"][::-1]
    for broken in (
        content[: len(content) // 2],
        b"no tile",
        save(tensors | {"points": bad}, metadata=about),
        save(tensors | {"points": bad[:0]}, metadata=about),
        save(tensors | {"other": bad}, metadata=about),
        save({n: t for n, t in tensors.items() if n != "phase.normals"}, metadata=about),
        save(tensors, metadata={}),
        save(tensors, metadata={TILE_ENTRY: json.dumps(telling | {"index": 2})}),
        save(tensors, metadata={TILE_ENTRY: json.dumps(telling | {"voxel": 0})}),
        save(tensors, metadata={TILE_ENTRY: json.dumps(telling | {"spacing": 0})}),
        save(tensors, metadata={TILE_ENTRY: json.dumps(telling | {"support": turned})}),
    ):
        path.write_bytes(broken)
        with pytest.raises(TileFormat):
            read_tile(path)
    path.write_bytes(save(tensors, metadata={TILE_ENTRY: json.dumps(telling | {"version": 9})}))
    with pytest.raises(TileVersion):
        read_tile(path)


def test_damaged_plans_are_refused(tmp_path: Path) -> None:
    scene = ball()
    told = json.loads((scene.plan_dir / "plan.json").read_text())
    shutil.copy(scene.plan_dir / "side.safetensors", tmp_path)
    plan = tmp_path / "plan.json"
    for broken in (
        "{",
        "[]",
        json.dumps(told | {"format": "other"}),
        json.dumps(told | {"tiles": told["tiles"][:1]}),
        json.dumps(told | {"cuts": []}),
        json.dumps(told | {"scale": "wide"}),
        json.dumps(told | {"report": None}),
    ):
        plan.write_text(broken)
        with pytest.raises(TileFormat):
            read_plan(tmp_path)
    plan.write_text(json.dumps(told | {"version": 2}))
    with pytest.raises(TileVersion):
        read_plan(tmp_path)
    plan.write_text(json.dumps(told))
    (tmp_path / "side.safetensors").write_bytes(b"")
    with pytest.raises(TileFormat):
        read_plan(tmp_path)


def test_a_join_wants_the_field_of_every_tile(tmp_path: Path) -> None:
    scene = ball()
    with pytest.raises(TileFormat, match="1 fields of 2 tiles"):
        join_files(scene.plan_dir, scene.fields[:1], scene.cloud, tmp_path, small())


@pytest.mark.parametrize(
    "fit", [{"iterations": "many"}, {"iterations": True}, {"seconds": [1]}, {"seconds": -1}]
)
def test_a_report_that_does_not_count_is_refused(fit: dict[str, Any], tmp_path: Path) -> None:
    scene = ball()
    paths = [tmp_path / name / "field.safetensors" for name in ("0", "1")]
    for path in paths:
        path.parent.mkdir()
        path.with_name("report.json").write_text(json.dumps({"fit": fit}))
    with pytest.raises(TileFormat, match=next(iter(fit))):
        tiles_report(scene.plan, scene.tiles, paths)


def test_damaged_patches_are_refused(tmp_path: Path) -> None:
    content = ball().fields[0].with_name("patches.safetensors").read_bytes()
    path = tmp_path / "patches.safetensors"
    path.write_bytes(content)
    assert len(read_patches(path).patches.points) > 1000
    path.write_bytes(content[:-4])
    with pytest.raises(TileFormat):
        read_patches(path)
