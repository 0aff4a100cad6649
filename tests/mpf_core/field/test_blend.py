"""Many networks as one field, and its file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.numpy import load, save

from mpf_core.cloud.normalize import Similarity
from mpf_core.errors import FieldFormat, FieldVersion
from mpf_core.field import MetricPhaseField
from mpf_core.field.blend import BlendedField, Side, Tile
from mpf_core.field.blendfile import ENTRY, blend_bytes, load_field, save_field
from mpf_core.field.fitted import NAMES, field_of, theta_of
from mpf_core.field.footprint import Footprint
from mpf_core.field.partition import Cut, Partition
from tests.mpf_core.clouds import Array, sphere

UTM = np.array([691_607.0, 5_334_760.0, 512.0])
HALF = 0.1


def blend(*, colors: bool = False) -> BlendedField:
    """Two networks side by side, of which one's unit is half of the other's."""
    whole = Similarity(UTM, 0.5)
    frames = [
        Similarity(UTM - np.array([1.0, 0, 0]), 1.0),
        Similarity(UTM + np.array([1.0, 0, 0]), 2.0),
    ]
    tiles = tuple(
        Tile(
            MetricPhaseField(width=16, omega=7.0, generator=torch.Generator().manual_seed(k)), frame
        )
        for k, frame in enumerate(frames)
    )
    labels = np.zeros((20, 20, 20), np.int8)
    labels[:, :, :3], labels[:, :, -3:] = -1, 1
    paint = np.full((200, 3), 7, np.uint8) if colors else None
    footprint = Footprint.of(sphere(200), spacing=0.1, reach=0.2, thickness=None, colors=paint)
    box = np.array([[-1.05] * 3, [1.05] * 3])
    partition = Partition((Cut(0, 0.0, HALF, -1, -2),), 2)
    return BlendedField(tiles, partition, Side(labels, 1.15), whole, box, footprint)


def line(x: float, y: float = 0.2, z: float = 0.1) -> Array:
    return np.array([[x, y, z]])


def test_one_tile_alone_is_its_own_field_in_the_units_of_the_whole() -> None:
    made = blend()
    first, second = made.tiles
    x = line(-0.4)
    own = (made.similarity.to_input(x) - first.similarity.center) * first.similarity.scale
    assert made.level()(x) == pytest.approx(0.5 * theta_of(first.field)(own), abs=1e-6)
    assert made.values("phi")(x) == pytest.approx(0.5 * field_of(first.field, "phi")(own), abs=1e-6)
    assert made.values("P")(x) == pytest.approx(field_of(first.field, "P")(own), abs=1e-5)
    x = line(0.4)
    own = (made.similarity.to_input(x) - second.similarity.center) * second.similarity.scale
    assert made.level()(x) == pytest.approx(0.25 * theta_of(second.field)(own), abs=1e-6)


@pytest.mark.parametrize("name", NAMES)
def test_the_field_goes_over_from_one_tile_to_the_other_without_a_jump(name: str) -> None:
    x = np.stack([np.linspace(-0.15, 0.15, 3001), np.full(3001, 0.2), np.full(3001, 0.1)], 1)
    values = blend().values(name)(x).astype(np.float64)
    steepest = np.abs(np.diff(values)).max() / 1e-4
    assert steepest < 60 if name == "P" else steepest < 12


def test_the_sign_does_not_depend_on_which_field_is_asked_where() -> None:
    made = blend()
    x = np.random.default_rng(0).uniform(-0.7, 0.7, (4000, 3))
    alone = np.abs(x[:, 0]) > HALF
    assert np.array_equal(
        np.sign(made.level()(x))[alone], np.sign(made.values("phi")(x))[alone]
    )  # Proposition 1
    assert np.array_equal(made.level()(x[~alone]), made.values("phi")(x[~alone]))


def test_far_from_the_samples_the_whole_knows_the_side() -> None:
    made = blend()
    x = np.random.default_rng(0).uniform(-1.1, 1.1, (2000, 3))
    far = np.abs(x[:, 2]) > 0.95
    signs = np.sign(made.level()(x[far]))
    assert np.array_equal(signs, np.sign(x[far, 2]))
    assert np.array_equal(made.values("P")(x[far]), signs)
    assert (made.values("r")(x[far]) > 0).all()


@pytest.mark.parametrize("colors", [True, False])
def test_a_blend_comes_back_bit_for_bit(tmp_path: Path, colors: bool) -> None:
    before, path = blend(colors=colors), tmp_path / "field.safetensors"
    save_field(before, path)
    after = load_field(path)
    assert isinstance(after, BlendedField)
    assert blend_bytes(after) == path.read_bytes()
    x = np.random.default_rng(0).uniform(-1.1, 1.1, (500, 3))
    for name in NAMES:
        assert np.array_equal(before.values(name)(x), after.values(name)(x))
    assert np.array_equal(before.gradient()(x), after.gradient()(x))
    assert np.array_equal(before.footprint.lattice, after.footprint.lattice)
    assert (after.footprint.colors is None) == (not colors)


def changed(**about: Any) -> bytes:
    content = blend_bytes(blend())
    told = json.loads(_metadata(content)) | about
    return bytes(save(load(content), metadata={ENTRY: json.dumps(told)}))


def _metadata(content: bytes) -> str:
    size = int.from_bytes(content[:8], "little")
    text: str = json.loads(content[8 : 8 + size])["__metadata__"][ENTRY]
    return text


@pytest.mark.parametrize(
    "about",
    [
        {"cuts": []},
        {"cuts": [[0, 0.0, 0.1, -1, -1]]},
        {"cuts": [[0, 0.0, 0.1, 0, -2]]},
        {"cuts": [[3, 0.0, 0.1, -1, -2]]},
        {"cuts": [[0, 0.0, 0.0, -1, -2]]},
        {"cuts": [[0, 0.0, 0.1, -1.5, -2]]},
        {"cuts": "none"},
        {"tiles": []},
        {"tiles": [1, 2]},
        {"voxels": 21},
        {"voxels": 10**6},
        {"half": None},
        {"scale": 0},
        {"box": [[1, 1, 1], [0, 0, 0]]},
    ],
)
def test_a_blend_that_cannot_be_is_refused(tmp_path: Path, about: dict[str, Any]) -> None:
    path = tmp_path / "field.safetensors"
    path.write_bytes(changed(**about))
    with pytest.raises(FieldFormat):
        load_field(path)


def test_a_later_blend_is_refused_as_such(tmp_path: Path) -> None:
    path = tmp_path / "field.safetensors"
    path.write_bytes(changed(version=2))
    with pytest.raises(FieldVersion):
        load_field(path)


def test_what_lacks_a_network_or_holds_absurd_weights_is_refused(tmp_path: Path) -> None:
    path, content = tmp_path / "field.safetensors", blend_bytes(blend())
    tensors = load(content)
    name = next(n for n in tensors if n.startswith("1."))
    about = {ENTRY: _metadata(content)}
    path.write_bytes(save({n: t for n, t in tensors.items() if n != name}, metadata=about))
    with pytest.raises(FieldFormat, match="lacks"):
        load_field(path)
    path.write_bytes(save(tensors | {name: np.full_like(tensors[name], np.nan)}, metadata=about))
    with pytest.raises(FieldFormat, match="not finite"):
        load_field(path)
    path.write_bytes(content[:-100])
    with pytest.raises(FieldFormat):
        load_field(path)
