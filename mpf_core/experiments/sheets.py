"""Open surfaces: single sheets with a boundary."""

from __future__ import annotations

import itertools

import numpy as np

from mpf_core.experiments.build import (
    blade,
    curve,
    grid,
    joined,
    lathe,
    patch,
    placed,
    tidy,
)
from mpf_core.surface.mesh import Mesh

_FINE = 81


def _square(half_x: float = 1.0, half_y: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    x, y = np.linspace(-half_x, half_x, _FINE), np.linspace(-half_y, half_y, _FINE)
    u, v = np.meshgrid(x, y, indexing="ij")
    return u, v


def sheet() -> Mesh:
    """A flat square."""
    return patch((-1, -1, 0), (2, 0, 0), (0, 2, 0))


def wave() -> Mesh:
    """z = ¼ sin 3x cos 2.5y over a square."""
    x, y = _square()
    return grid(np.stack([x, y, 0.25 * np.sin(3 * x) * np.cos(2.5 * y)], axis=2))


def saddle() -> Mesh:
    """z = ½ (x² − y²) over a square."""
    x, y = _square()
    return grid(np.stack([x, y, 0.5 * (x**2 - y**2)], axis=2))


def moebius() -> Mesh:
    """A strip joined with half a turn: one side, one boundary curve."""
    angle = np.linspace(0, 2 * np.pi, 240, endpoint=False)[:, None]
    across = np.linspace(-0.4, 0.4, 31)
    radius = 1 + across * np.cos(angle / 2)
    height = across * np.sin(angle / 2)
    return grid(
        np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=2), twist=True
    )


def vase() -> Mesh:
    """A vase of one layer with a bottom, open at the top."""
    wall = curve(
        [(0.30, 0.0), (0.48, 0.35), (0.50, 0.7), (0.28, 1.25), (0.22, 1.5), (0.40, 1.9)], 100
    )
    return lathe([(0.0, 0.0), (0.15, 0.0), *wall])


def hat() -> Mesh:
    """A hat of one layer: a crown and a wide brim that waves."""
    crown = curve([(0.0, 0.62), (0.22, 0.62), (0.38, 0.52), (0.44, 0.25), (0.47, 0.02)], 60)
    brim = curve([(0.47, 0.02), (0.56, 0.0), (0.8, 0.02), (1.0, 0.12)], 40)
    plain = lathe(np.concatenate([crown, brim[1:]])[::-1])
    x, y, z = plain.vertices.T
    lift = 0.10 * np.clip(np.hypot(x, y) - 0.5, 0, None) * np.cos(2 * np.arctan2(y, x))
    return Mesh(np.stack([x, y, z + lift], axis=1), plain.faces)


def leaf() -> Mesh:
    """A pointed leaf, folded along its midrib, its rim waving."""
    plain = blade(2.0, 0.9, bend=0.12, fold=0.45)
    x, y, z = plain.vertices.T
    wavy = z + 0.10 * y**2 / 0.2 * np.sin(9 * x) * 0.5
    return Mesh(np.stack([x, y, wavy], axis=1), plain.faces)


# Half the outline of a maple leaf about its middle: degrees from the tip, radius.
_MAPLE = (
    (0, 1.15), (7, 0.86), (15, 0.90), (20, 0.52), (30, 0.62), (37, 0.80), (47, 1.08), (54, 0.86),
    (62, 0.92), (70, 0.60), (80, 0.64), (90, 0.70), (100, 0.90), (109, 0.64), (122, 0.62),
    (134, 0.50), (150, 0.46), (168, 0.44), (180, 0.34),
)  # fmt: skip


def maple_leaf() -> Mesh:
    """A leaf of pointed lobes, cupped and waving."""
    degrees, radius = np.array(_MAPLE).T
    half = np.stack([radius * np.cos(np.radians(degrees)), radius * np.sin(np.radians(degrees))], 1)
    corners = np.concatenate([half[:-1], half[:0:-1] * [1, -1], half[:1]])
    steps = np.linspace(0, 1, 14, endpoint=False)[:, None]
    outline = np.concatenate([a + steps * (b - a) for a, b in itertools.pairwise(corners)])
    share = np.linspace(0, 1, 60)[:, None, None]
    x, y = np.moveaxis(share * outline, 2, 0)
    cup = 0.10 * np.hypot(x, y) ** 2 - 0.12 * np.abs(y) + 0.05 * np.sin(5 * x + 2 * y)
    return grid(np.stack([x, y, cup], axis=2).swapaxes(0, 1)[::-1], around=True)


def dress() -> Mesh:
    """A skirt and a bodice of one layer in deep folds, open above and below."""
    profile = curve([(0.88, 0.0), (0.66, 0.5), (0.36, 1.05), (0.24, 1.3), (0.33, 1.65)], 120)
    radius, height = profile.T
    angle = np.linspace(0, 2 * np.pi, 360, endpoint=False)[:, None]
    depth = 0.16 * np.clip(1.15 - height, 0, None)
    folded = radius * (1 + depth * np.cos(11 * angle + 0.6 * np.sin(2 * angle)))
    flat = np.broadcast_to(height, folded.shape)
    points = np.stack([folded * np.cos(angle), 0.85 * folded * np.sin(angle), flat], axis=2)
    return grid(points, around=True)


def flower() -> Mesh:
    """Three whorls of overlapping petals, layer over layer."""
    petals = []
    for count, rise, length, start, height in (
        (8, 12, 1.0, 0.0, 0.0), (7, 34, 0.84, 14.0, 0.06), (5, 58, 0.62, 33.0, 0.13),
    ):  # fmt: skip
        petal = blade(length, 0.62 * length, bend=0.16, fold=0.55, tip=1.35)
        for k in range(count):
            turn = start + 360 * k / count
            at = 0.10 * np.cos(np.radians(turn)), 0.10 * np.sin(np.radians(turn)), height
            petals.append(placed(petal, at, turn=turn, rise=rise, roll=13))
    return joined(*petals)


def bowl() -> Mesh:
    """A hemisphere of one layer with a flat rim: two smooth pieces that meet in a crease."""
    dip = np.radians(np.linspace(-90, 0, 80))
    round_part = np.stack([0.72 * np.cos(dip), 0.72 * np.sin(dip)], axis=1)
    round_part[0, 0] = 0.0
    return lathe([*round_part, (1.0, 0.0)])


def t_junction() -> Mesh:
    """A sheet that stands on the middle of another: an edge of three faces."""
    standing = patch((0, -0.7, 0), (0, 1.4, 0), (0, 0, 1))
    halves = [patch((x, -0.7, 0), (1, 0, 0), (0, 1.4, 0)) for x in (-1, 0)]
    return _welded(*halves, standing)


def x_junction() -> Mesh:
    """Two sheets that pass through each other at 60°: an edge of four faces."""
    rays = [np.array([np.cos(a), 0, np.sin(a)]) for a in np.radians([30, -30, 150, -150])]
    return _welded(*[patch((0, -0.8, 0), ray, (0, 1.6, 0)) for ray in rays])


def holed_body(*, base: bool = False) -> Mesh:
    """A pear-like body with a round hole in its base, as scans of standing figures have.

    base: with what it stands on, instead of the hole
    """
    wall = curve(
        [(0.30, 0.0), (0.62, 0.18), (0.72, 0.6), (0.50, 1.15), (0.36, 1.45), (0.25, 1.75)], 90
    )
    top = np.stack(
        [
            0.25 * np.cos(np.radians(a := np.linspace(8, 90, 24))),
            1.75 + 0.25 * np.sin(np.radians(a)),
        ],
        axis=1,
    )
    top[-1, 0] = 0.0
    bottom = [[0.0, 0.0], [0.15, 0.0]] if base else np.empty((0, 2))
    return lathe(np.concatenate([bottom, wall, top]))


def _welded(*meshes: Mesh) -> Mesh:
    both = joined(*meshes)
    return tidy(both.vertices, both.faces)
