"""Closed bodies, thin ones among them, and bodies with sheets attached."""

from __future__ import annotations

import numpy as np
import trimesh

from mpf_core.experiments.build import (
    blade,
    box,
    boxes,
    curve,
    grid,
    joined,
    lathe,
    painted,
    patch,
    placed,
    tube,
)
from mpf_core.surface.mesh import Mesh

_CLAY, _SOIL, _GREEN, _LIGHT_GREEN = (184, 100, 66), (84, 62, 48), (62, 128, 58), (112, 164, 72)
_WOOD, _CANVAS, _HULL = (120, 82, 52), (232, 224, 202), (96, 62, 44)


def _ball(subdivisions: int) -> Mesh:
    made = trimesh.creation.icosphere(subdivisions=subdivisions)
    return Mesh(np.array(made.vertices, np.float64), np.array(made.faces, np.int64))


def sphere() -> Mesh:
    """The unit sphere as 81 920 triangles (its distances are those of the true sphere)."""
    return _ball(6)


def torus() -> Mesh:
    """A ring of radius 0.7 about which a circle of radius 0.3 turns."""
    angle = np.linspace(-np.pi, np.pi, 241)
    angle[-1] = -np.pi
    return lathe(np.stack([0.7 + 0.3 * np.cos(angle), 0.3 * np.sin(angle)], axis=1), 512)


def knurled_ring() -> Mesh:
    """A torus under 73 by 31 bumps 0.008 high: a relief of waves 0.06 long."""
    around = np.linspace(0, 2 * np.pi, 1314, endpoint=False)[:, None]
    across = np.linspace(0, 2 * np.pi, 559)
    across[-1] = 0.0
    tube = 0.3 + 0.008 * np.sin(73 * around) * np.sin(31 * across)
    radius = 0.7 + tube * np.cos(across)
    height = tube * np.sin(across)
    points = np.stack([radius * np.cos(around), radius * np.sin(around), height], axis=2)
    return grid(points, around=True)


def plate(thickness: float) -> Mesh:
    """A solid square plate, its side 2."""
    return box((-1, -1, -thickness / 2), (1, 1, thickness / 2))


def cube_with_sheet() -> Mesh:
    """A cube and a single sheet that stands on one of its faces: the paper's toy."""
    return joined(box((-0.4,) * 3, (0.4,) * 3), patch((-0.3, 0.4, 0), (0.6, 0, 0), (0, 0.7, 0)))


def lattice() -> Mesh:
    """A cage of square bars, four along each edge."""
    at = np.linspace(-1, 1, 4)
    bars = []
    for first in at:
        for second in at:
            span = [(-1.05, 1.05), (first - 0.05, first + 0.05), (second - 0.05, second + 0.05)]
            bars += [span, [span[1], span[0], span[2]], [span[1], span[2], span[0]]]
    return boxes(*bars)


def nested_shells() -> Mesh:
    """Three thin-walled hollow balls, one inside the other: wall 0.03 of a radius of 1."""
    ball = _ball(5)
    shells = []
    for radius in (1.0, 0.68, 0.36):
        shells.append(Mesh(radius * ball.vertices, ball.faces))
        shells.append(Mesh((radius - 0.03) * ball.vertices, ball.faces[:, ::-1]))
    return joined(*shells)


def spike_ball() -> Mesh:
    """A ball with 40 slender spikes."""
    ball = _ball(7)
    k = np.arange(40) + 0.5
    height, angle = 1 - k / 20, k * 2.399963
    flat = np.sqrt(1 - height**2)
    spikes = np.stack([flat * np.cos(angle), flat * np.sin(angle), height], axis=1)
    nearness = (ball.vertices @ spikes.T).max(axis=1)
    return Mesh(ball.vertices * (0.5 + 0.5 * np.exp(90 * (nearness - 1)))[:, None], ball.faces)


def thin_bowl() -> Mesh:
    """A bowl with a rim, as a solid with a wall of 0.03."""
    dip = np.radians(np.linspace(-90, 0, 80))
    outer = np.stack([0.72 * np.cos(dip), 0.72 * np.sin(dip)], axis=1)
    inner = np.stack([0.69 * np.cos(dip), 0.69 * np.sin(dip)], axis=1)[::-1]
    outer[0, 0] = inner[-1, 0] = 0.0
    rim = [(1.0, 0.0), (1.0, 0.03), (0.69, 0.03)]
    return lathe([*outer, *rim, *inner])


def ship() -> Mesh:
    """A solid hull, thin masts and yards, and sails of one layer."""
    parts = [painted(_hull(), _HULL)]
    for x, height in ((-0.55, 0.85), (0.02, 1.1), (0.55, 0.9)):
        mast = np.linspace((x, 0, 0), (x, 0, height), 12)
        parts.append(painted(tube(mast, 0.014), _WOOD))
        for foot, head, width in ((0.14, 0.46, 0.62), (0.50, 0.76, 0.48)):
            low, high = foot * height, head * height
            parts.append(painted(_sail(x + 0.03, low, high, width * height), _CANVAS))
            yard = np.linspace((x + 0.02, -0.5 * width * height, high),
                               (x + 0.02, 0.5 * width * height, high), 8)  # fmt: skip
            parts.append(painted(tube(yard, 0.008), _WOOD))
    jib = np.linspace((0.92, 0, 0.0), (1.28, 0, 0.22), 8)
    parts.append(painted(tube(jib, 0.012), _WOOD))
    parts.append(painted(_jib(), _CANVAS))
    return joined(*parts)


def _hull() -> Mesh:
    along = np.linspace(-1, 1, 121)[:, None]
    around = np.linspace(-1, 1, 61)
    half_beam = 0.24 * np.clip(1 - np.abs(along) ** 2.6, 0, None) ** 0.7
    depth = 0.26 * (1 - 0.35 * np.abs(along) ** 3)
    y = half_beam * np.sign(around) * np.abs(around) ** 0.8
    z = -depth * np.clip(1 - np.abs(around) ** 2.4, 0, None) ** 0.75
    x = along * (1 - 0.12 * np.abs(z) / 0.26) + 0 * around
    deck_y = half_beam * np.linspace(1, -1, 13)[1:-1]
    deck = np.stack([along + 0 * deck_y, deck_y, 0 * deck_y], axis=2)
    section = np.concatenate([np.stack([x, y, z], axis=2), deck], axis=1)
    return grid(np.swapaxes(section, 0, 1), around=True)


def _sail(x: float, low: float, high: float, width: float) -> Mesh:
    u = np.linspace(-1, 1, 33)[:, None]
    v = np.linspace(0, 1, 25)
    belly = 0.30 * width * (1 - u**2) * np.sin(np.pi * np.clip(v * 0.85 + 0.08, 0, 1))
    y = 0.5 * width * u * (1.08 - 0.16 * v) + 0 * v
    return grid(np.stack([x + belly, y, low + (high - low) * v + 0 * u], axis=2))


def _jib() -> Mesh:
    head, tack, clew = (
        np.array([0.60, 0, 0.72]),
        np.array([1.22, 0, 0.21]),
        np.array([0.66, 0, 0.14]),
    )
    u, v = np.linspace(0, 1, 30)[:, None, None], np.linspace(0, 1, 30)[None, :, None]
    flat = head + u * ((1 - v) * (tack - head) + v * (clew - head))
    belly = 0.16 * u * np.sin(np.pi * v) * np.array([0.0, 1.0, 0.0])
    return grid(flat + belly * (1 - 0.5 * u))


def potted_plant() -> Mesh:
    """A solid clay pot with earth in it, thin stems, and leaves of one layer."""
    wall = [(0.0, 0.0), (0.27, 0.0), (0.36, 0.52), (0.41, 0.52), (0.42, 0.64), (0.365, 0.64),
            (0.355, 0.55)]  # fmt: skip
    earth = curve([(0.355, 0.55), (0.2, 0.58), (0.0, 0.60)], 20)
    earth[-1, 0] = 0.0
    parts = [painted(lathe(wall), _CLAY), painted(lathe(earth), _SOIL)]
    # turn, rise, reach, height of the stem's end, length and width of the leaf
    for k, (turn, rise, reach, height, length, width) in enumerate(
        (
            (20, 35, 0.22, 1.15, 0.80, 0.34), (75, 10, 0.30, 0.95, 0.74, 0.32),
            (130, 50, 0.14, 1.40, 0.72, 0.30), (185, 20, 0.28, 1.10, 0.80, 0.34),
            (235, 5, 0.32, 0.90, 0.70, 0.30), (285, 40, 0.18, 1.30, 0.76, 0.32),
            (335, 15, 0.30, 1.00, 0.74, 0.32), (50, 72, 0.06, 1.55, 0.62, 0.24),
        )
    ):  # fmt: skip
        away = np.array([np.cos(np.radians(turn)), np.sin(np.radians(turn)), 0.0])
        foot, end = 0.06 * away + (0, 0, 0.57), reach * away + (0, 0, height)
        middle = 0.5 * (foot + end) - 0.18 * reach * away + (0, 0, 0.05)
        stem = tube(curve([foot, middle, end], 24), np.linspace(0.024, 0.015, 24))
        leaf = blade(length, width, bend=0.38, fold=0.30)
        green = _GREEN if k % 2 else _LIGHT_GREEN
        parts.append(painted(stem, _LIGHT_GREEN))
        parts.append(painted(placed(leaf, end, turn=turn, rise=rise), green))
    return joined(*parts)


def room() -> Mesh:
    """A corner of a room: walls, a table, chairs, a shelf, a lamp and a curtain."""
    table = boxes(
        [(-0.5, 0.5), (-0.3, 0.3), (0.50, 0.53)],
        *[
            [(x, x + 0.04), (y, y + 0.04), (0.0, 0.51)]
            for x in (-0.48, 0.44)
            for y in (-0.28, 0.24)
        ],
    )
    shelf = boxes(
        *[[(-0.95, -0.70), (0.1, 0.9), (z, z + 0.02)] for z in (0.1, 0.4, 0.7, 1.0)],
        *[[(-0.95, -0.70), (y, y + 0.02), (0.0, 1.02)] for y in (0.1, 0.88)],
    )
    chair = boxes(
        [(-0.15, 0.15), (-0.15, 0.15), (0.30, 0.32)],
        [(-0.15, 0.15), (0.13, 0.15), (0.32, 0.66)],
        *[
            [(x, x + 0.03), (y, y + 0.03), (0.0, 0.31)]
            for x in (-0.15, 0.12)
            for y in (-0.15, 0.12)
        ],
    )
    pole = tube(np.linspace((0.75, 0.75, 0.0), (0.75, 0.75, 1.05), 12), 0.015)
    shade = placed(lathe([(0.20, 0.95), (0.11, 1.2)]), (0.75, 0.75, 0))
    along = np.linspace(-0.9, -0.1, 120)[:, None]
    hang = np.linspace(0.15, 1.25, 12)
    fold = 0.93 + 0.03 * np.sin(45 * along) * (1.1 - 0.3 * hang)
    curtain = grid(np.stack([along + 0 * hang, fold, hang + 0 * along], axis=2))
    return joined(
        patch((-1, -1, 0), (2, 0, 0), (0, 2, 0)),
        patch((-1, -1, 0), (0, 2, 0), (0, 0, 1.4)),
        patch((-1, 1, 0), (2, 0, 0), (0, 0, 1.4)),
        table, shelf, pole, shade, curtain,
        placed(chair, (0.0, 0.55, 0)), placed(chair, (0.1, -0.58, 0), turn=170),
    )  # fmt: skip
