"""What the samples of a tile say, as a file beside its field: `patches.safetensors`.

The last step of the joined mesh needs it. To find it out takes as long as hundreds of steps of
the fit, so it is done once, by whoever fits the tile. Lengths are those of the tile's frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from mpf_core.cloud.normalize import Similarity
from mpf_core.field.header import Found, described, number, opened, packed, signature, wrong
from mpf_core.field.network import check_tensors
from mpf_core.surface.patches import Patches
from mpf_core.tiles.plan import as_tile_errors

VERSION = 1
ENTRY = "metric-phase-patches"
PATCHES = "patches.safetensors"
LARGEST_FILE = 2**30  # bytes
MOST = 10**7  # patches
NAMES = ("points", "normals", "curvature", "spacing", "sheet")


@dataclass(frozen=True)
class TilePatches:
    """The patches, and the median spacing of the samples that they were fitted to."""

    patches: Patches
    median_spacing: float


class Fit(NamedTuple):
    """Of a tile's local fits: thickness of its shells, standard error, kernel over the spacing, and
    the median spacing of the samples; lengths are the tile's."""

    thickness: float
    deviation: float
    kernel: float
    median_spacing: float


def patch_bytes(patches: Patches, median_spacing: float) -> bytes:
    """The file's content."""
    lengths = ("thickness", "kernel", "deviation")
    about = {name: float(getattr(patches, name)) for name in lengths}
    about |= {"median_spacing": median_spacing}
    tensors = {name: np.asarray(getattr(patches, name)) for name in NAMES}
    return packed(ENTRY, {**signature(VERSION), **about}, tensors)


def read_patches(path: Path) -> TilePatches:
    """The file's patches. Raises TileFormat for anything else, TileVersion, OSError."""
    with as_tile_errors():
        return opened(path, LARGEST_FILE, _read)


def read_fit(path: Path) -> Fit:
    """What the file tells of its local fits, without the patches. Raises as `read_patches`."""
    with as_tile_errors():
        return opened(path, LARGEST_FILE, _fit)


def _fit(file: Any) -> Fit:
    about = described(file, ENTRY, VERSION)
    thickness, deviation = (number(about, n, 0.0, 4.0) for n in ("thickness", "deviation"))
    kernel, spacing = number(about, "kernel", 1e-3, 1e3), number(about, "median_spacing", 1e-9, 4.0)
    return Fit(thickness, deviation, kernel, spacing)


def _read(file: Any) -> TilePatches:
    fit = _fit(file)
    shape = file.get_slice("points").get_shape() if "points" in file.keys() else []  # noqa: SIM118
    if len(shape) != 2 or not 1 <= shape[0] <= MOST:
        raise wrong("it holds no patches, or too many")
    n = int(shape[0])
    needed: Found = {
        "points": ("F32", (n, 3)),
        "normals": ("F32", (n, 3)),
        "curvature": ("F32", (n, 3, 3)),
        "spacing": ("F32", (n,)),
        "sheet": ("I8", (n,)),
    }
    check_tensors(file, needed, {})
    points, normals, curvature, local, sheet = (file.get_tensor(name) for name in NAMES)
    if not all(np.isfinite(a).all() for a in (points, normals, curvature, local)):
        raise wrong("it holds values that are not finite")
    tree = cKDTree(points)
    patches = Patches(
        points, tree, normals, curvature, local, sheet, fit.thickness, fit.kernel, fit.deviation
    )
    return TilePatches(patches, fit.median_spacing)


def in_frame(found: TilePatches, own: Similarity, whole: Similarity) -> TilePatches:
    """Patches of the frame `own` in the frame `whole`."""
    unit = whole.scale / own.scale
    patches = found.patches
    points = whole.to_normalised(own.to_input(patches.points)).astype(np.float32)
    moved = Patches(
        points=points,
        tree=cKDTree(points),
        normals=patches.normals,
        curvature=patches.curvature / np.float32(unit),
        spacing=patches.spacing * np.float32(unit),
        sheet=patches.sheet,
        thickness=patches.thickness * unit,
        kernel=patches.kernel,
        deviation=patches.deviation * unit,
    )
    return TilePatches(moved, found.median_spacing * unit)
