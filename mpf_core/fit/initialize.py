"""The warm start: where r and θ begin, from the samples' neighbourhoods and the free space.

Solids, thin walls among them: θ is the signed distance. Sheets: θ is the signed distance to a thin
closed shell, whose outer wall goes through the samples and whose second wall lies 2ε behind, always
on the same side of the consistently oriented normals; a shell centred on the samples, or one whose
side is left to the fit, grows pockets. A sheet inside a solid: the same shell, empty.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mpf_core.cloud.neighbors import CHUNK, Neighborhoods, nearest
from mpf_core.fit.closure import close_gaps, settle
from mpf_core.fit.freespace import INSIDE, OUTSIDE, SURFACE, FreeSpace, flood
from mpf_core.fit.localfit import FACING, LocalDistance, LocalFit
from mpf_core.fit.orientation import orient, outward_seeds
from mpf_core.fit.sides import Sides, parted, sides

# Local spacings between which the distance to the nearest sample takes over from the local fit.
FAR = (2.0, 3.0)
EXPLAINED = 0.95  # share of samples that bound a solid, below which gaps are looked for
# Samples per analysed one from which the nearest one's normal will do: seconds for millions.
DENSE = 3
# Half thickness ε of the shell around a sheet: SHELL_SPACINGS of the median spacing, between SHELL
# and THICKEST, normalised. At 0.004 a tenth of a noisy helmet is lost after 1000 steps, at 0.006 a
# thousandth; a thicker one is fitted sooner and extracted on fewer cells, and as long as it is
# thinner than the spacing no two sheets that the samples tell apart meet. The last step thins it.
SHELL, SHELL_SPACINGS, THICKEST = 0.006, 0.3, 0.009
# A fit sees so many points whatever the area, and keeps no thin shell where that is large: ε is
# at least this share of the square root of the area.
SHELL_OF_AREA = 0.0023

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Targets:
    """What the fit starts from at n points: θ*, r* ≥ 0, and the side (+1 outside, −1 enclosed,
    0 not known), all (n,) float32; and whether the nearest sample is of a thin wall or rod,
    (n,)."""

    theta: NDArray[np.float32]
    r: NDArray[np.float32]
    side: NDArray[np.float32]
    layered: NDArray[np.bool_]


@dataclass(frozen=True)
class Initialization:
    """The classical start of one cloud. `normals` (n, 3) are oriented outwards where that is
    defined and consistently elsewhere; `seeded` is the share of samples that bound a solid, thin
    walls among them; `shell` is ε, and what each sample bounds is in `bounds`."""

    local: LocalFit
    space: FreeSpace
    normals: Array
    seeded: float
    shell: float
    bounds: Sides

    @property
    def thinnest(self) -> float:
        """Thickness of the thinnest walls (5th percentile), infinite where there are none."""
        gap = self.local.neighbours.gap
        layered = self.local.neighbours.layered
        return float(np.percentile(gap[layered], 5)) if layered.mean() > 0.01 else np.inf

    @cached_property
    def rims(self) -> NDArray[np.bool_]:
        """(n,) whether each sample is at the rim of a thin wall: where the data of one side end, or
        beside a face across. Rods, which turn everywhere, have none."""
        cloud, solid = self.local.neighbours, self.bounds.solid > 0.5
        walls = cloud.layered & ~cloud.rods
        cosine = np.einsum("nki,ni->nk", self.normals[cloud.links], self.normals)
        across = ((np.abs(cosine) < FACING) & solid[cloud.links]).any(1)
        thin = walls | walls[cloud.links].any(1)
        ends = walls & cloud.rim.any(1)
        return np.asarray(solid & (ends | (across & thin)))

    def normals_at(self, samples: Array, at_rims: float = 1.0) -> Array:
        """(n, 3) oriented normals at samples (n, 3) on or close to the surface: of length 1,
        `at_rims` where the nearest sample is one of `rims`, 0 where those around contradict it."""
        sure = self.local.neighbours.consistent * np.where(self.rims, at_rims, 1.0)
        if samples is self.local.neighbours.points:
            return self.normals * sure[:, None]
        normals = np.empty(samples.shape)
        dense = len(samples) > DENSE * len(self.normals)
        for i in range(0, len(samples), CHUNK):
            part = samples[i : i + CHUNK]
            if dense:
                index = nearest(self.local.neighbours.tree, part, 1, self.local.threads)[1][:, 0]
                found = self.normals[index]
            else:
                near = self.local.at(part)
                found, index = near.normal, near.first
            normals[i : i + CHUNK] = found * sure[index, None]
        return normals

    def at(self, x: Array) -> Targets:
        """Targets at x (n, 3), normalised."""
        near = self.local.at(x)
        label = self.space.label_at(x)
        solid, buried = near.mean(self.bounds.solid), near.mean(self.bounds.buried)
        shell = np.sqrt((near.signed + self.shell) ** 2 + near.beyond**2) - self.shell
        r = np.sqrt(near.signed**2 + near.beyond**2)
        body = self._body(near, label, r)
        theta = solid * body + (1 - solid - 2 * buried) * shell
        # Far away the nearest sample stands in for the surface.
        share = np.clip((near.nearest / near.spacing - FAR[0]) / (FAR[1] - FAR[0]), 0, 1)
        sign = np.where(label == INSIDE, -1.0, 1.0)
        distance = sign * (near.nearest - (1 - solid) * self.shell)
        theta += share * (distance - theta)
        r += share * (near.nearest - r)
        side = np.where(label == INSIDE, -1, np.where(label == OUTSIDE, 1, 0))
        layered = self.local.neighbours.layered[near.first]
        return Targets(
            theta.astype(np.float32), r.astype(np.float32), side.astype(np.float32), layered
        )

    def _body(self, near: LocalDistance, label: NDArray[np.int8], r: Array) -> Array:
        """Signed distance to a solid: by the side of the oriented samples, where a thin wall ends
        at its rim; more than a voxel away the voxels that know a side know it better, but not
        between the samples of a thin wall, into which a flood leaks by its rim."""
        wall = np.maximum(near.signed, near.edge)
        wall = np.where((near.signed > 0) & (near.edge > 0), r, wall)
        layered = self.local.neighbours.layered
        side = np.where(layered[near.first], wall, near.signed)
        over = (near.mean(layered.astype(np.float64)) > 0.1) & (near.edge <= 0)
        label = np.where((r > self.space.voxel) & ~over, label, SURFACE)
        return np.asarray(np.where(label == INSIDE, -r, np.where(label == OUTSIDE, r, side)))


@dataclass(frozen=True)
class Facing:
    """Which way samples face before gaps are closed: `normals` (n, 3) oriented by `space` as the
    flood fills it; None for a tile, whose sides are the whole's."""

    space: FreeSpace | None
    normals: Array


def facing(neighbours: Neighborhoods, threads: int = -1) -> Facing:
    """The first half of `initialize`."""
    space = parted(neighbours, flood(neighbours, threads=threads))
    return Facing(space, orient(neighbours, outward_seeds(neighbours, space)))


def initialize(
    neighbours: Neighborhoods,
    first: Facing | None = None,
    *,
    shell: float | None = None,
    threads: int = -1,
) -> Initialization:
    """The classical start from the neighbourhoods of a cloud in [-1, 1]³. `first` is their
    `facing` where that is known already; `shell` is ε, by the spacing if not given."""
    if shell is None:
        shell = half_thickness(neighbours)
    first = first or facing(neighbours, threads)
    space, normals = first.space, first.normals
    assert space is not None
    bounds = sides(neighbours, normals, space)
    if (bounds.solid > 0.5).mean() < EXPLAINED:
        closed = close_gaps(neighbours, normals, space)
        if closed is not space:
            space = closed
            normals = orient(neighbours, outward_seeds(neighbours, closed))
            bounds = sides(neighbours, normals, space)
    solid = bounds.solid > 0.5
    space = settle(neighbours, normals, solid, space)
    local = LocalFit(neighbours, normals, threads, solid)
    return Initialization(local, space, normals, float(solid.mean()), shell, bounds)


def half_thickness(neighbours: Neighborhoods) -> float:
    """ε by the spacing, and by the area, normalised."""
    by_area = SHELL_OF_AREA * np.sqrt(neighbours.areas.sum())
    wanted = max(SHELL_SPACINGS * neighbours.median_spacing, by_area)
    return float(np.clip(wanted, SHELL, THICKEST))
