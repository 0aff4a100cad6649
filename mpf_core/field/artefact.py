"""The fitted field as a file: `field.safetensors`, all that later extractions need.

Tensors are the network's weights (float32, by their names in `MetricPhaseField`), `samples` (m, 3)
uint16 and, where the cloud had colours, `colors` (m, 3) uint8. The header's only metadata entry is
one JSON text, so that equal fields make equal files. A file is judged by its header before any
tensor is read: it may come from anywhere.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mpf_core.field.fitted import FittedField
from mpf_core.field.header import (
    box_in,
    colors_in,
    described,
    footprint_in,
    frame_in,
    frame_of,
    lengths_in,
    lengths_of,
    opened,
    packed,
    samples_in,
    samples_of,
    signature,
)
from mpf_core.field.network import (
    check_tensors,
    empty_network,
    fill,
    sizes_of,
    tensors_of,
    weights_of,
)
from mpf_core.files import write_atomically

VERSION = 1
ENTRY = "metric-phase-field"
LARGEST_FILE = 32 * 2**20  # bytes: the widest network and a full footprint take half of it


def field_bytes(fitted: FittedField) -> bytes:
    """The file's content."""
    about = {
        **signature(VERSION),
        **sizes_of(fitted.field),
        **frame_of(fitted.similarity),
        "box": fitted.box.tolist(),
        **lengths_of(fitted.footprint),
    }
    return packed(ENTRY, about, weights_of(fitted.field) | samples_of(fitted.footprint))


def save_field(fitted: FittedField, path: str | Path) -> None:
    """Write the field to `path`, whole or not at all."""
    write_atomically(path, field_bytes(fitted))


def load_field(path: str | Path) -> FittedField:
    """The field that `save_field` wrote.

    Raises FieldFormat for anything else, FieldVersion for a file of later software, OSError.
    """
    return opened(Path(path), LARGEST_FILE, _read)


def _read(file: Any) -> FittedField:
    about = described(file, ENTRY, VERSION)
    field = empty_network(about)
    similarity, box, lengths = frame_in(about), box_in(about), lengths_in(about)
    check_tensors(file, tensors_of(field) | {"samples": samples_in(file)}, colors_in(file))
    fill(field, file)
    return FittedField(field, similarity, box, footprint_in(file, lengths))
