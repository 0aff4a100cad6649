"""A blended field as a file, and either kind of `field.safetensors` by what its header says.

A blend holds one set of weights for each tile under `{number}.`, `samples` (m, 3) uint16 and
perhaps `colors` (m, 3) uint8 of the whole, and the whole's known sides as two bit maps, `near` and
`inside`. It is read as strictly as the file of one network (`artefact`).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open

from mpf_core.field import artefact
from mpf_core.field.blend import BlendedField, Side, Tile
from mpf_core.field.fitted import Fitted, FittedField
from mpf_core.field.header import (
    Found,
    box_in,
    colors_in,
    described,
    footprint_in,
    frame_in,
    frame_of,
    lengths_in,
    lengths_of,
    number,
    numbers,
    opened,
    packed,
    samples_in,
    samples_of,
    signature,
    whole,
    wrong,
)
from mpf_core.field.network import (
    check_tensors,
    empty_network,
    fill,
    sizes_of,
    tensors_of,
    weights_of,
)
from mpf_core.field.partition import Cut, Partition
from mpf_core.files import write_atomically
from mpf_core.options import MOST_TILES

VERSION = 1
ENTRY = "metric-phase-blend"
LARGEST_GRID = 320  # voxels a side


def save_field(fitted: Fitted, path: str | Path) -> None:
    """Write a field of either kind to `path`, whole or not at all."""
    if isinstance(fitted, BlendedField):
        write_atomically(path, blend_bytes(fitted))
    else:
        assert isinstance(fitted, FittedField)
        artefact.save_field(fitted, path)


def load_field(path: str | Path) -> FittedField | BlendedField:
    """The field that `save_field` wrote.

    Raises FieldFormat for anything else, FieldVersion for a file of later software, OSError.
    """
    path = Path(path)
    if _is_blend(path):
        return opened(path, MOST_TILES * artefact.LARGEST_FILE, _read)
    return artefact.load_field(path)


def blend_bytes(blend: BlendedField) -> bytes:
    """The file's content."""
    about = {
        **signature(VERSION),
        **frame_of(blend.similarity),
        "box": blend.box.tolist(),
        **lengths_of(blend.footprint),
        "half": blend.side.half,
        "voxels": len(blend.side.labels),
        "cuts": cuts_as_lists(blend.partition),
        "tiles": [sizes_of(tile.field) | frame_of(tile.similarity) for tile in blend.tiles],
    }
    tensors: dict[str, NDArray[Any]] = samples_of(blend.footprint) | side_bits(blend.side)
    for index, tile in enumerate(blend.tiles):
        tensors |= weights_of(tile.field, f"{index}.")
    return packed(ENTRY, about, tensors)


def cuts_as_lists(partition: Partition) -> list[list[float]]:
    """The cuts for JSON."""
    return [[c.axis, c.at, c.half, c.low, c.high] for c in partition.cuts]


def partition_in(about: dict[str, Any], tiles: int) -> Partition:
    """The cuts that a header holds: a tree whose leaves are the tiles, each once."""
    rows = about.get("cuts")
    if not isinstance(rows, list) or len(rows) != tiles - 1:
        raise wrong("its cuts do not make its tiles")
    cuts = []
    for index, row in enumerate(rows):
        axis, at, half, low, high = numbers({"cut": row}, "cut", 5, 1e6)
        children = [int(low), int(high)]
        good = axis in (0, 1, 2) and abs(at) <= 2 and 0 < half <= 2 and children == [low, high]
        if not good or any(-tiles > c or 0 <= c <= index or c >= len(rows) for c in children):
            raise wrong(f"its cut {index} cannot be")
        cuts.append(Cut(int(axis), at, half, children[0], children[1]))
    met = sorted(child for cut in cuts for child in (cut.low, cut.high))
    if cuts and met != [*range(-tiles, 0), *range(1, len(cuts))]:
        raise wrong("its cuts do not make a tree")
    return Partition(tuple(cuts), tiles)


def side_bits(side: Side) -> dict[str, NDArray[np.uint8]]:
    """Two bit maps: where networks are asked, and where it is inside."""
    return {"near": np.packbits(side.labels == 0), "inside": np.packbits(side.labels < 0)}


def bits_of(voxels: int) -> Found:
    """Type and shape of those bit maps."""
    return dict.fromkeys(("near", "inside"), ("U8", (-(-(voxels**3) // 8),)))


def side_in(file: Any, voxels: int, half: float) -> Side:
    """The sides, from tensors that were checked."""
    shape = (voxels,) * 3
    near, inside = (
        np.unpackbits(file.get_tensor(name), count=voxels**3).reshape(shape).astype(bool)
        for name in ("near", "inside")
    )
    labels = np.where(near, 0, np.where(inside, -1, 1)).astype(np.int8)
    return Side(labels, half)


def _is_blend(path: Path) -> bool:
    try:
        with safe_open(path, framework="np") as file:
            return ENTRY in (file.metadata() or {})
    except (SafetensorError, OSError):
        return False  # the reader of single fields says what is wrong


def _read(file: Any) -> BlendedField:
    about = described(file, ENTRY, VERSION)
    told = about.get("tiles")
    if (
        not isinstance(told, list)
        or not 1 <= len(told) <= MOST_TILES
        or not all(isinstance(one, dict) for one in told)
    ):
        raise wrong("it does not tell its tiles")
    partition = partition_in(about, len(told))
    similarity, box, lengths = frame_in(about), box_in(about), lengths_in(about)
    voxels, half = whole(about, "voxels", 2, LARGEST_GRID), number(about, "half", 0.1, 4.0)
    fields, frames = [empty_network(one) for one in told], [frame_in(one) for one in told]
    needed: Found = {"samples": samples_in(file)} | bits_of(voxels)
    for index, field in enumerate(fields):
        needed |= tensors_of(field, f"{index}.")
    check_tensors(file, needed, colors_in(file))
    for index, field in enumerate(fields):
        fill(field, file, f"{index}.")
    tiles = tuple(Tile(field, frame) for field, frame in zip(fields, frames, strict=True))
    side = side_in(file, voxels, half)
    return BlendedField(tiles, partition, side, similarity, box, footprint_in(file, lengths))
