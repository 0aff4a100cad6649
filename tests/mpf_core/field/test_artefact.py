"""The field as a file: everything comes back, and nothing else gets in."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from safetensors import safe_open
from safetensors.numpy import load, save

from mpf_core.cloud.normalize import Similarity
from mpf_core.errors import FieldFormat, FieldVersion
from mpf_core.field import MetricPhaseField
from mpf_core.field.artefact import ENTRY, LARGEST_FILE, field_bytes, load_field, save_field
from mpf_core.field.fitted import NAMES, FittedField, field_of
from mpf_core.field.footprint import STEP, Footprint
from tests.mpf_core.clouds import sphere

UTM = np.array([691_607.123456789, 5_334_760.987654321, 512.0])


def fitted(width: int = 16, samples: int = 300, *, colors: bool = False) -> FittedField:
    field = MetricPhaseField(
        width=width, omega=7.0, beta=33.0, generator=torch.Generator().manual_seed(4)
    )
    paint = np.random.default_rng(0).integers(0, 256, (samples, 3)).astype(np.uint8)
    footprint = Footprint.of(
        sphere(samples), spacing=0.1, reach=1 / 3, thickness=0.012, colors=paint if colors else None
    )
    box = np.array([[-1.05, -1.05, -0.7], [1.05, 1.05, 1 / 3]])
    return FittedField(field, Similarity(UTM, 0.1 + 1e-17 + 1 / 7), box, footprint)


@pytest.mark.parametrize("composite", ["product", "phase"])
def test_the_phi_of_an_ablation_stays_what_it_was(tmp_path: Path, composite: str) -> None:
    plain = fitted()
    assert b"composite" not in field_bytes(plain)
    other = MetricPhaseField(width=16, omega=7.0, composite=composite)
    save_field(replace(plain, field=other), tmp_path / "field.safetensors")
    after = load_field(tmp_path / "field.safetensors")
    assert after.field.composite == composite
    for name in NAMES:
        x = np.random.default_rng(0).uniform(-1, 1, (50, 3))
        assert np.array_equal(field_of(other, name)(x), field_of(after.field, name)(x))


@pytest.mark.parametrize("colors", [True, False])
def test_everything_comes_back_bit_for_bit(tmp_path: Path, colors: bool) -> None:
    before, path = fitted(colors=colors), tmp_path / "field.safetensors"
    save_field(before, path)
    after = load_field(path)
    for (name, old), (again, new) in zip(
        before.field.state_dict().items(), after.field.state_dict().items(), strict=True
    ):
        assert (name, old.dtype) == (again, new.dtype)
        assert torch.equal(old, new)
    assert (after.field.width, after.field.omega) == (16, 7.0)
    assert after.field.softplus_slope == before.field.softplus_slope
    assert after.similarity.scale == before.similarity.scale
    assert np.array_equal(after.similarity.center, UTM)
    assert np.array_equal(after.box, before.box)
    one, two = before.footprint, after.footprint
    assert np.array_equal(one.points, two.points)
    assert (one.cover, one.spacing, one.reach, one.thickness) == (
        two.cover, two.spacing, two.reach, two.thickness
    )  # fmt: skip
    assert (two.colors is not None) is colors
    assert one.colors is None or np.array_equal(one.colors, two.colors)
    x = np.random.default_rng(1).uniform(-1, 1, (500, 3))
    for name in NAMES:
        assert np.array_equal(field_of(before.field, name)(x), field_of(after.field, name)(x))
    assert field_bytes(after) == path.read_bytes()


def test_the_file_of_a_full_sized_field_is_under_two_mebibytes() -> None:
    content = field_bytes(fitted(256, 100_000, colors=True))
    assert 1.2 * 2**20 < len(content) < 2 * 2**20


def test_others_can_read_it(tmp_path: Path) -> None:
    path = tmp_path / "field.safetensors"
    save_field(fitted(), path)
    with safe_open(path, framework="pt") as file:
        assert file.get_tensor("siren.shared_weight").shape == (16, 16)
        about = json.loads(file.metadata()[ENTRY])
    assert (about["version"], about["width"]) == (1, 16)
    assert about["center"] == UTM.tolist()
    assert "metric-phase-fields" in about["software"]


def test_a_footprint_keeps_few_samples_near_all_of_them() -> None:
    samples = np.random.default_rng(0).uniform(-1, 1, (20_000, 3)) * [1, 1, 0.01]
    colors = np.arange(60_000).reshape(-1, 3).astype(np.uint8)
    whole = Footprint.of(samples, spacing=0.1, reach=0.1, thickness=None, colors=colors)
    assert len(whole.points) == 20_000
    assert np.abs(whole.points - samples).max() <= STEP / 2 + 1e-12
    thin = Footprint.of(samples, spacing=0.1, reach=0.1, thickness=None, colors=colors, most=1000)
    assert 400 < len(thin.points) <= 1000
    distance, _ = thin.tree.query(samples)
    assert distance.max() <= thin.cover < 0.2
    assert whole.cover < 1e-4
    place = whole.tree.query(thin.points)[1]
    assert thin.colors is not None
    assert np.array_equal(thin.colors, colors[place])


# What does not get in

GOOD = field_bytes(fitted(samples=60))


def told(tmp_path: Path, content: bytes) -> FieldFormat | FieldVersion | None:
    path = tmp_path / "field.safetensors"
    path.write_bytes(content)
    try:
        loaded = load_field(path)
    except (FieldFormat, FieldVersion) as error:
        assert error.advice
        return error
    # What is let in can be used.
    x = np.random.default_rng(1).uniform(-2, 2, (20, 3))
    assert np.isfinite(field_of(loaded.field, "phi")(x)).all()
    assert np.isfinite(loaded.similarity.to_input(loaded.box)).all()
    return None


def changed(tensors: dict[str, Any] | None = None, **about: Any) -> bytes:
    """A good file with some tensors (None: left out) and some metadata replaced."""
    length = int.from_bytes(GOOD[:8], "little")
    described = json.loads(json.loads(GOOD[8 : 8 + length])["__metadata__"][ENTRY]) | about
    found = load(GOOD) | (tensors or {})
    kept = {name: values for name, values in found.items() if values is not None}
    content: bytes = save(kept, metadata={ENTRY: json.dumps(described)})
    return content


def test_a_good_file_is_let_in(tmp_path: Path) -> None:
    assert told(tmp_path, GOOD) is None
    assert told(tmp_path, changed()) is None


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"ply\nformat ascii 1.0\n",
        bytes(100),
        b"\xff" * 100,
        GOOD[:-1],
        GOOD + b"\0",
        GOOD[: len(GOOD) // 2],
        save({"a": np.zeros(3)}),
        save({"a": np.zeros(3)}, metadata={ENTRY: "{"}),
        save({"a": np.zeros(3)}, metadata={ENTRY: "[" * 100_000}),
        save({"a": np.zeros(3)}, metadata={ENTRY: "[1]"}),
        save({"a": np.zeros(3)}, metadata={ENTRY: '{"version": ' + "9" * 5000 + "}"}),
        bytes(LARGEST_FILE + 1),
    ],
    ids=range(13),
)
def test_other_files_are_refused(tmp_path: Path, content: bytes) -> None:
    assert isinstance(told(tmp_path, content), FieldFormat)


def test_later_versions_are_refused_by_name(tmp_path: Path) -> None:
    error = told(tmp_path, changed(version=2, software="metric-phase-fields 9"))
    assert isinstance(error, FieldVersion)
    assert "metric-phase-fields 9" in str(error)


NAN, INFINITE = float("nan"), float("inf")


@pytest.mark.parametrize(
    "about",
    [
        *({"version": v} for v in (0, -1, 1.0, True, None, "1")),
        *({"width": w} for w in (0, 7, 1025, 17, 10**9, "16", None)),
        *({"omega": v} for v in (0, -1, NAN, INFINITE, "7", None, [7])),
        {"softplus_slope": NAN},
        *({"composite": c} for c in ("sum", "", None, 1, ["phase"])),
        *({"center": c} for c in ([], [1, 2], [1, 2, NAN], [1, 2, 1e308], "abc", [[1], 2, 3])),
        *({"scale": s} for s in (0, -1, NAN, INFINITE, 1e-300, 1e300)),
        *({"box": b} for b in ([], [[0] * 3] * 2, [[1] * 3, [-1] * 3], [[-9] * 3, [9] * 3], 5)),
        *({name: v} for name in ("cover", "spacing", "reach") for v in (-1, NAN, 5, None)),
        {"spacing": 0},
        {"thickness": 0},
        {"thickness": INFINITE},
    ],
    ids=str,
)
def test_metadata_out_of_range_is_refused(tmp_path: Path, about: dict[str, Any]) -> None:
    assert isinstance(told(tmp_path, changed(**about)), FieldFormat)


@pytest.mark.parametrize(
    "tensors",
    [
        {"beta": None},
        {"samples": None},
        {"other": np.zeros(3, np.float32)},
        {"samples": np.zeros((0, 3), np.uint16)},
        {"samples": np.zeros((5, 2), np.uint16)},
        {"samples": np.zeros((5, 3), np.float32)},
        {"samples": np.zeros((2**20 + 1, 3), np.uint16)},
        {"colors": np.zeros((5, 3), np.uint8)},
        {"siren.input_weight": np.zeros((16, 2), np.float32)},
        {"siren.input_weight": np.zeros((16, 3), np.float64)},
        {"siren.input_weight": np.full((16, 3), NAN, np.float32)},
        {"siren.input_weight": np.full((16, 3), 1e30, np.float32)},
        {"siren.phase_offset": np.array(-INFINITE, np.float32)},
    ],
    ids=range(13),
)
def test_tensors_of_another_kind_are_refused(tmp_path: Path, tensors: dict[str, Any]) -> None:
    assert isinstance(told(tmp_path, changed(tensors)), FieldFormat)


@settings(
    max_examples=300,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(data=st.data())
def test_damaged_files_are_refused_or_harmless(tmp_path: Path, data: st.DataObject) -> None:
    content = bytearray(GOOD)
    header = 8 + int.from_bytes(GOOD[:8], "little")
    for _ in range(data.draw(st.integers(1, 4))):
        # Half of the damage in the header, where it does most.
        end = data.draw(st.sampled_from([8, header, len(content)]))
        at = data.draw(st.integers(0, min(end, len(content)) - 1))
        how = data.draw(st.sampled_from(["set", "drop", "insert", "swap"]))
        if how == "set":
            content[at] = data.draw(st.integers(0, 255))
        elif how == "drop":
            del content[at : at + data.draw(st.integers(1, 20))]
        elif how == "insert":
            content[at:at] = data.draw(st.binary(min_size=1, max_size=20))
        else:
            part = content[at : at + 4]
            other = data.draw(st.integers(0, len(content) - 1))
            content[other : other + len(part)] = part
        if not content:
            break
    told(tmp_path, bytes(content))
