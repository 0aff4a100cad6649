"""The files of a split cloud: `plan.json`, and a self-contained `tile-000.safetensors` for each.

Both are judged by their headers before anything is read: they may come from anywhere.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpf_core.cloud.normalize import Similarity
from mpf_core.errors import FieldFormat, FieldVersion, TileFormat, TileVersion
from mpf_core.field.blend import Side
from mpf_core.field.blendfile import (
    LARGEST_GRID,
    bits_of,
    cuts_as_lists,
    partition_in,
    side_bits,
    side_in,
)
from mpf_core.field.header import (
    Found,
    described,
    frame_in,
    frame_of,
    number,
    numbers,
    opened,
    packed,
    signature,
    whole,
)
from mpf_core.field.network import check_tensors
from mpf_core.field.partition import Partition
from mpf_core.files import write_atomically
from mpf_core.fit.inherited import Phase
from mpf_core.options import MOST_TILES

VERSION = 1
PLAN_ENTRY, TILE_ENTRY = "metric-phase-plan", "metric-phase-tile"
PLAN, SIDE = "plan.json", "side.safetensors"
LARGEST_PLAN, LARGEST_TILE = 2**20, 2**31  # bytes

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Plan:
    """How a cloud is split.

    similarity: from the input's frame to the whole's normalised one, in which the partition, the
    sides and `spacing`, the samples' median one, are; shell: ε in the input's units, the same in
    all tiles; samples: of each tile, halos included; report: what the whole's report tells of the
    input and of its start
    """

    similarity: Similarity
    partition: Partition
    side: Side
    spacing: float
    shell: float
    samples: tuple[int, ...]
    report: dict[str, Any]

    @property
    def tiles(self) -> int:
        """How many there are."""
        return self.partition.tiles

    @property
    def files(self) -> tuple[str, ...]:
        """Names of the tiles' files beside plan.json."""
        return tuple(tile_name(index) for index in range(self.tiles))


@dataclass(frozen=True)
class TileData:
    """One tile, self-contained.

    points: (n, 3) its samples and those of its halo, input frame; similarity: from there to its own
    normalised frame; phase: of the whole around it, in its frame; spacing: of the whole's samples,
    input units; support: (2, 3) where its field has weight, input frame
    """

    index: int
    tiles: int
    points: Array
    similarity: Similarity
    phase: Phase
    spacing: float
    support: Array


def tile_name(index: int) -> str:
    """The file of tile `index`."""
    return f"tile-{index:03d}.safetensors"


def write_plan(plan: Plan, folder: Path) -> None:
    """side.safetensors, then plan.json: where that is, all is."""
    about = {
        "format": PLAN_ENTRY,
        **signature(VERSION),
        **frame_of(plan.similarity),
        "cuts": cuts_as_lists(plan.partition),
        "tiles": [
            {"file": name, "samples": count}
            for name, count in zip(plan.files, plan.samples, strict=True)
        ],
        "spacing": plan.spacing,
        "shell": plan.shell,
        "report": plan.report,
    }
    side = {"half": plan.side.half, "voxels": len(plan.side.labels), **signature(VERSION)}
    write_atomically(folder / SIDE, packed(PLAN_ENTRY, side, side_bits(plan.side)))
    text = json.dumps(about, indent=2, ensure_ascii=False, allow_nan=False)
    write_atomically(folder / PLAN, (text + "\n").encode())


def read_plan(folder: str | Path) -> Plan:
    """The plan in a folder. Raises TileFormat for anything else, TileVersion, OSError."""
    folder = Path(folder)
    with as_tile_errors():
        about = _plan_json(folder / PLAN)
        told = about.get("tiles")
        if not isinstance(told, list) or not 1 <= len(told) <= MOST_TILES:
            raise TileFormat("the plan does not tell its tiles", where=PLAN)
        samples = tuple(whole(_mapping(one), "samples", 1, 10**9) for one in told)
        similarity, partition = frame_in(about), partition_in(about, len(told))
        spacing, shell = number(about, "spacing", 1e-12, 2), number(about, "shell", 0, 1e100)
        side = opened(folder / SIDE, LARGEST_PLAN * 8, _read_side)
        report = _mapping(about.get("report"))
    return Plan(similarity, partition, side, spacing, shell, samples, report)


def tile_bytes(tile: TileData) -> bytes:
    """The content of a tile's file."""
    phase = tile.phase
    about = {
        **signature(VERSION),
        "index": tile.index,
        "tiles": tile.tiles,
        **frame_of(tile.similarity),
        "spacing": tile.spacing,
        "support": tile.support.tolist(),
        "corner": phase.corner.tolist(),
        "voxel": phase.voxel,
        "shell": phase.shell,
        "enclosures": phase.enclosures,
    }
    tensors: dict[str, NDArray[Any]] = {
        "points": tile.points,
        "phase.points": phase.points,
        "phase.normals": phase.normals,
        "phase.solid": phase.solid,
        "phase.buried": phase.buried,
        "phase.labels": phase.labels,
    }
    return packed(TILE_ENTRY, about, tensors)


def read_tile(path: str | Path) -> TileData:
    """The tile that `split_file` wrote. Raises TileFormat for anything else, TileVersion,
    OSError."""
    with as_tile_errors():
        return opened(Path(path), LARGEST_TILE, _read_tile)


def _read_tile(file: Any) -> TileData:
    about = described(file, TILE_ENTRY, VERSION)
    tiles = whole(about, "tiles", 1, MOST_TILES)
    index = whole(about, "index", 0, tiles - 1)
    frame, support = frame_in(about), np.reshape(numbers(about, "support", 6, 1e100), (2, 3))
    if not (support[0] < support[1]).all():
        raise TileFormat("the tile's support has no volume")
    corner = np.array(numbers(about, "corner", 3, 100.0))
    lengths = [number(about, name, 1e-9, 2.0) for name in ("voxel", "shell")]
    enclosures = whole(about, "enclosures", 0, 10**7)
    spacing = number(about, "spacing", 1e-100, 1e100)
    n, m = (_rows(file, name) for name in ("points", "phase.points"))
    grid = tuple(file.get_slice("phase.labels").get_shape()) if m else ()
    if len(grid) != 3 or not all(1 <= k <= LARGEST_GRID for k in grid):
        raise TileFormat("the tile's labels are no grid", where="phase.labels")
    needed: Found = {
        "points": ("F64", (n, 3)),
        "phase.points": ("F64", (m, 3)),
        "phase.normals": ("F64", (m, 3)),
        "phase.solid": ("F64", (m,)),
        "phase.buried": ("F64", (m,)),
        "phase.labels": ("I8", grid),
    }
    check_tensors(file, needed, {})
    points, places, normals, solid, buried, labels = (file.get_tensor(name) for name in needed)
    for values in (points, places, normals, solid, buried):
        if not np.isfinite(values).all():
            raise TileFormat("the tile holds values that are not finite")
    phase = Phase(
        places, normals, solid, buried, labels, corner, lengths[0], lengths[1], enclosures
    )
    return TileData(index, tiles, points, frame, phase, spacing, support)


def _rows(file: Any, name: str) -> int:
    if name not in file.keys():  # noqa: SIM118
        raise TileFormat(f"the tile lacks {name}")
    shape = file.get_slice(name).get_shape()
    if len(shape) != 2 or not 1 <= shape[0] <= 10**8:
        raise TileFormat(f"the tile's {name} are no points")
    return int(shape[0])


def _read_side(file: Any) -> Side:
    about = described(file, PLAN_ENTRY, VERSION)
    voxels, half = whole(about, "voxels", 2, LARGEST_GRID), number(about, "half", 0.1, 4.0)
    check_tensors(file, bits_of(voxels), {})
    return side_in(file, voxels, half)


def _plan_json(path: Path) -> dict[str, Any]:
    if path.stat().st_size > LARGEST_PLAN:
        raise TileFormat("the plan is larger than any", where=PLAN)
    try:
        about = _mapping(json.loads(path.read_bytes()))
    except (ValueError, RecursionError) as error:
        raise TileFormat("the plan is not JSON", where=PLAN) from error
    if about.get("format") != PLAN_ENTRY:
        raise TileFormat("this is not the plan of a split cloud", where=PLAN)
    if whole(about, "version", 1, 10**6) > VERSION:
        raise TileVersion("the plan was written by newer software", where=PLAN)
    return about


def _mapping(value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise TileFormat("the plan is not an object where it should be", where=PLAN)
    return value


@contextmanager
def as_tile_errors() -> Iterator[None]:
    """The readers of fields speak of fields; here the same faults are those of tiles."""
    try:
        yield
    except FieldVersion as error:
        raise TileVersion(error.message, advice=error.advice) from error
    except FieldFormat as error:
        what = error.message.partition(": ")[2]
        message = f"this is not a part of a split cloud that can be used: {what}"
        raise TileFormat(message, where=error.where, advice="Split the cloud again.") from error
