"""The warm start: where r and θ begin, from the samples' neighbourhoods and the free space.

Solids: θ is the signed distance. Sheets: θ is the signed distance to a thin closed shell, whose
outer wall goes through the samples and whose second wall lies 2ε behind, always on the same side
of the consistently oriented normals; a shell centred on the samples, or one whose side is left to
the fit, grows pockets.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mpf_core.cloud.neighbors import Neighborhoods
from mpf_core.fit.closure import close_gaps
from mpf_core.fit.freespace import INSIDE, OUTSIDE, FreeSpace, flood
from mpf_core.fit.localfit import LocalFit
from mpf_core.fit.orientation import orient, outward_seeds

FAR = 3.0  # local spacings beyond which the distance to the nearest sample is the better estimate
MOSTLY_ENCLOSED = 0.5  # share of samples that bound enclosed space; below it, gaps are looked for
# Half thickness ε of the shell around a sheet, normalised units. At 0.004 a tenth of a noisy helmet
# is lost after 1000 steps, at 0.006 a thousandth; the fit ends thinner where the data allow.
SHELL = 0.006

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Targets:
    """What the fit starts from at n points: θ*, r* ≥ 0, and the side (+1 outside, −1 enclosed,
    0 not known), all (n,) float32."""

    theta: NDArray[np.float32]
    r: NDArray[np.float32]
    side: NDArray[np.float32]


@dataclass(frozen=True)
class Initialization:
    """The classical start of one cloud. `normals` (n, 3) are oriented outwards where that is
    defined and consistently elsewhere; `seeded` is the share of samples that bound enclosed
    space."""

    local: LocalFit
    space: FreeSpace
    normals: Array
    seeded: float
    shell: float

    def normals_at(self, samples: Array) -> Array:
        """(n, 3) oriented unit normals at samples (n, 3) on or close to the surface."""
        if samples is self.local.neighbours.points:
            return self.normals
        return self.local.at(samples).normal

    def at(self, x: Array) -> Targets:
        """Targets at x (n, 3), normalised."""
        near = self.local.at(x)
        shell = np.sqrt((near.signed + self.shell) ** 2 + near.beyond**2) - self.shell
        r = np.sqrt(near.signed**2 + near.beyond**2)
        far = near.nearest > FAR * near.spacing
        r = np.where(far, near.nearest, r)
        theta = np.where(far, near.nearest - self.shell, shell)
        label = self.space.label_at(x)
        theta = np.where(label == INSIDE, -r, theta)
        # In voxels that discs fill, beside enclosed space, the oriented side decides.
        beside = self.space.is_near_inside(x)
        theta = np.where(beside, np.where(near.signed < 0, -r, r), theta)
        side = np.where(label == INSIDE, -1, np.where(label == OUTSIDE, 1, 0))
        return Targets(theta.astype(np.float32), r.astype(np.float32), side.astype(np.float32))


def initialize(neighbours: Neighborhoods, *, threads: int = -1) -> Initialization:
    """The classical start from the neighbourhoods of a cloud in [-1, 1]³."""
    space = flood(neighbours)
    seeds = outward_seeds(neighbours, space)
    normals = orient(neighbours, seeds)
    if (seeds != 0).mean() < MOSTLY_ENCLOSED:
        closed = close_gaps(neighbours, normals, space)
        if closed is not space:
            space, seeds = closed, outward_seeds(neighbours, closed)
            normals = orient(neighbours, seeds)
    local = LocalFit(neighbours, normals, threads)
    return Initialization(local, space, normals, float((seeds != 0).mean()), SHELL)
