"""Exact test shapes of the paper's kinds, and clouds sampled from them.

Every shape is normalised: box centred at the origin, longest side 2. It is the polyhedron that
`shape` returns; samples lie on its triangles and `distances` are to them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mpf_core.errors import OptionsError
from mpf_core.experiments import sheets, solids
from mpf_core.experiments.build import normalised
from mpf_core.quality.meshio import read_mesh
from mpf_core.quality.metrics import point_distances
from mpf_core.quality.sampling import sample_surface
from mpf_core.surface.mesh import Mesh
from mpf_core.surface.normals import face_normals

Floats = NDArray[np.float64]
Kind = Literal["solid", "sheet", "mixed"]

PLATE_THICKNESSES = (0.1, 0.05, 0.01, 0.005)


@dataclass(frozen=True)
class ShapeSpec:
    """A test shape: a closed `solid`, a `sheet` with a boundary, or `mixed`. Where a scan lacks a
    part of a body, `whole` builds all of it, in the same box."""

    name: str
    about: str
    kind: Kind
    build: Callable[[], Mesh]
    whole: Callable[[], Mesh] | None = None


def _spec(
    name: str,
    kind: Kind,
    build: Callable[[], Mesh],
    about: str | None = None,
    whole: Callable[[], Mesh] | None = None,
) -> ShapeSpec:
    text = about or (build.__doc__ or "").partition("\n\n")[0]
    return ShapeSpec(name, " ".join(text.split()), kind, build, whole)


_ALL = (
    _spec("cube-sheet", "mixed", solids.cube_with_sheet),
    _spec("ship", "mixed", solids.ship),
    _spec("potted-plant", "mixed", solids.potted_plant),
    _spec("room", "mixed", solids.room),
    _spec("wave", "sheet", sheets.wave),
    _spec("saddle", "sheet", sheets.saddle),
    _spec("sheet", "sheet", sheets.sheet),
    _spec("moebius", "sheet", sheets.moebius),
    _spec("vase", "sheet", sheets.vase),
    _spec("hat", "sheet", sheets.hat),
    _spec("leaf", "sheet", sheets.leaf),
    _spec("maple-leaf", "sheet", sheets.maple_leaf),
    _spec("dress", "sheet", sheets.dress),
    _spec("flower", "sheet", sheets.flower),
    _spec("bowl", "sheet", sheets.bowl),
    _spec("t-junction", "sheet", sheets.t_junction),
    _spec("x-junction", "sheet", sheets.x_junction),
    _spec("holed-body", "sheet", sheets.holed_body, whole=partial(sheets.holed_body, base=True)),
    _spec("sphere", "solid", solids.sphere),
    _spec("torus", "solid", solids.torus),
    _spec("knurled-ring", "solid", solids.knurled_ring),
    _spec("lattice", "solid", solids.lattice),
    _spec("nested-shells", "solid", solids.nested_shells),
    _spec("spike-ball", "solid", solids.spike_ball),
    _spec("thin-bowl", "solid", solids.thin_bowl),
    *(
        _spec(
            f"plate-{thickness:g}",
            "solid",
            partial(solids.plate, thickness),
            f"A solid square plate, its side 2 and its thickness {thickness:g}.",
        )
        for thickness in PLATE_THICKNESSES
    ),
)
SHAPES: dict[str, ShapeSpec] = {spec.name: spec for spec in _ALL}


@cache
def shape(name: str) -> Mesh:
    """The normalised triangles of a shape of SHAPES, or of the mesh file of that name; not to be
    changed in place."""
    if name not in SHAPES and Path(name).is_file():
        return normalised(read_mesh(Path(name)))
    if name not in SHAPES:
        raise OptionsError(f"there is no shape {name!r}", advice=f"Use one of {', '.join(SHAPES)}.")
    return normalised(SHAPES[name].build())


def whole(name: str, thickness: float = 0.0) -> Mesh:
    """What a surface of a cloud of `shape(name)` is compared to: the shape, with what scans of it
    lack, or both sides of a wall this thick about it; not to be changed in place."""
    return _whole(name, thickness)


@cache
def _whole(name: str, thickness: float) -> Mesh:
    build = SHAPES[name].whole if name in SHAPES else None
    mesh = shape(name) if build is None else normalised(build())
    return mesh if thickness == 0 else _both_sides(mesh, thickness)


def _both_sides(mesh: Mesh, thickness: float) -> Mesh:
    """Each triangle twice, half the thickness along its normal and against it, where samples of
    both sides lie (`sample_mesh`)."""
    corners = mesh.vertices[mesh.faces]  # (f, 3, 3)
    away = 0.5 * thickness * face_normals(mesh)[:, None]
    sides = np.concatenate([corners + away, (corners - away)[:, ::-1]])
    return Mesh(sides.reshape(-1, 3), np.arange(3 * len(sides)).reshape(-1, 3))


def distances(name: str, points: Floats) -> Floats:
    """(n,) exact distance of `points` (n, 3) to a shape."""
    return point_distances(points, shape(name))


def sample(
    name: str,
    count: int,
    seed: int = 0,
    *,
    noise: float = 0.0,
    outliers: float = 0.0,
    uneven: float = 1.0,
    holes: int = 0,
    thickness: float = 0.0,
) -> Floats:
    """(n, 3) points of a shape, uniform in area, without normals; see `sample_mesh`."""
    return sample_mesh(
        shape(name), count, seed,
        noise=noise, outliers=outliers, uneven=uneven, holes=holes, thickness=thickness,
    )  # fmt: skip


def sample_mesh(
    mesh: Mesh,
    count: int,
    seed: int = 0,
    *,
    noise: float = 0.0,
    outliers: float = 0.0,
    uneven: float = 1.0,
    holes: int = 0,
    thickness: float = 0.0,
) -> Floats:
    """`count` points on a normalised mesh, and what real clouds have besides.

    noise: standard deviation of a Gaussian on each coordinate (0.005 is 0.5 % of half the longest
        side)
    outliers: extra points anywhere in the box [-1.1, 1.1]³, as a share of `count`
    uneven: how many times denser the cloud is at the high end of x than at the low end
    holes: round parts of radius 0.2 without points
    thickness: both sides of a wall this thick instead of its middle
    """
    rng = np.random.default_rng(seed)
    gaps = sample_surface(mesh, holes, rng).points
    kept: list[Floats] = []
    missing = count
    while missing > 0:
        drawn = sample_surface(mesh, max(64, 2 * missing if uneven > 1 or holes else missing), rng)
        points = drawn.points
        if thickness > 0:
            side = rng.choice([-0.5, 0.5], size=(len(points), 1))
            points = points + thickness * side * face_normals(mesh)[drawn.faces]
        wanted = rng.random(len(points)) < uneven ** np.clip((drawn.points[:, 0] - 1) / 2, -1, 0)
        for gap in gaps:
            wanted &= np.linalg.norm(drawn.points - gap, axis=1) > 0.2
        kept.append(points[wanted][:missing])
        missing -= len(kept[-1])
    cloud = np.concatenate(kept)
    if noise > 0:
        cloud = cloud + rng.normal(scale=noise, size=cloud.shape)
    stray = rng.uniform(-1.1, 1.1, size=(round(outliers * count), 3))
    return np.concatenate([cloud, stray])
