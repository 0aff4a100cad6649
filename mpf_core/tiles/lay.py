"""The last step for a mesh that is of many tiles: what each tile's samples want, blended too."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpf_core.field.blend import BlendedField
from mpf_core.options import DataOptions
from mpf_core.surface.aim import Aim, aim_at
from mpf_core.surface.fidelity import taken
from mpf_core.surface.following import Data, follow
from mpf_core.surface.mesh import Mesh
from mpf_core.tiles.patchfile import PATCHES, in_frame, read_fit, read_patches

SUMMED = ("step", "outward", "front", "trust", "offset", "spacing")


def onto_patches(
    mesh: Mesh,
    blend: BlendedField,
    field_paths: Sequence[Path],
    shell: float,
    options: DataOptions,
    threads: int,
    clock: Callable[[], float],
) -> tuple[Mesh, dict[str, Any]]:
    """`mesh`, in the input's frame, moved onto the data of the tiles, and what the report tells.

    Patches lie beside the fields; `shell` is ε, input units.
    """
    if options.fidelity == "off":
        return mesh, {"applied": False, "reason": "switched off"}
    files = [path.with_name(PATCHES) for path in field_paths]
    if not all(file.is_file() for file in files):
        return mesh, {"applied": False, "reason": "a tile's patches are missing"}
    assert mesh.normals is not None
    begin, whole = clock(), blend.similarity
    vertices = whole.to_normalised(mesh.vertices)
    deviation, bandwidth = _fits(blend, files)
    data = Data(deviation, bandwidth, 2 * whole.length_to_normalised(shell))
    aim_of = partial(_aims, directions=mesh.normals, blend=blend, files=files, threads=threads)
    moved = follow(vertices, mesh.faces, mesh.normals, aim_of, data, threads)
    return taken(mesh, moved, whole, clock() - begin)


def _fits(blend: BlendedField, files: list[Path]) -> tuple[float, float]:
    """Standard error and bandwidth of the tiles' local fits, in the whole's frame, by medians."""
    errors, widths = [], []
    for tile, file in zip(blend.tiles, files, strict=True):
        fit, unit = read_fit(file), blend.similarity.scale / tile.similarity.scale
        errors.append(fit.deviation * unit)
        widths.append(fit.kernel * fit.median_spacing * unit)
    return float(np.median(errors)), float(np.median(widths))


def _aims(
    vertices: NDArray[np.float64],
    directions: NDArray[np.float64],
    blend: BlendedField,
    files: list[Path],
    threads: int,
) -> Aim:
    """Σ wᵢ of the tiles' aims. One tile's patches are in memory at a time."""
    count = len(vertices)
    sums = {name: np.zeros((count, 3) if k < 2 else count) for k, name in enumerate(SUMMED)}
    for share in blend.partition.shares(vertices):
        own = blend.tiles[share.tile].similarity
        patches = in_frame(read_patches(files[share.tile]), own, blend.similarity).patches
        aim = aim_at(patches, vertices[share.rows], directions[share.rows], threads)
        for name, total in sums.items():
            part = getattr(aim, name)
            weight = share.weights if part.ndim == 1 else share.weights[:, None]
            total[share.rows] += weight * part
    return Aim(**sums)
