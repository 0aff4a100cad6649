"""What the samples of a cloud say before anything is fitted to them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from mpf_core.cloud.denoise import denoise, smoothed
from mpf_core.cloud.neighbors import Neighborhoods, analyse
from mpf_core.fit.initialize import Facing, Initialization, facing, initialize
from mpf_core.options import Options
from mpf_core.watch import Watch

Array = NDArray[np.float64]
Face = Callable[[Neighborhoods], Facing]
Begin = Callable[[Neighborhoods, Facing | None], Initialization]


@dataclass(frozen=True)
class Known:
    """Normalised. `neighbours` of the analysed samples, noise taken off and thinned; `start`, None
    without a warm start; `points` (k, 3), where the surface terms are asked for; `noise`: spread
    of the measured samples about the surface; `denoised`: whether it was taken off."""

    neighbours: Neighborhoods
    start: Initialization | None
    points: Array
    noise: float
    denoised: bool


def known_of(
    samples: Array,
    options: Options,
    watch: Watch,
    threads: int,
    *,
    face: Face | None = None,
    begin: Begin | None = None,
) -> Known:
    """From samples (n, 3) in [-1, 1]³; `face` tells which way neighbourhoods face, and `begin`
    makes the classical start from them and, where that is known, from how they face: `facing` and
    `initialize` if not given."""
    face = face or partial(facing, threads=threads)
    begin = begin or partial(initialize, threads=threads)
    remove = options.fit.denoise != "off"
    cleaned = denoise(
        samples, remove=remove, most=options.fit.analysed, seed=options.seed, threads=threads
    )
    neighbours = analyse(cleaned.thinned, threads=threads)
    denoised = cleaned.points is not samples
    watch.enter("initialize")
    if not options.fit.warm_start:
        return Known(neighbours, None, cleaned.points, cleaned.sigma, denoised)
    first, calm = None, None
    if remove:  # for which gaps need not be closed
        first = face(neighbours)
        watch.check()
        calm = smoothed(cleaned.measured, neighbours, first.normals, threads)
    if calm is None:
        start = begin(neighbours, first)
        return Known(neighbours, start, cleaned.points, cleaned.sigma, denoised)
    neighbours = analyse(calm.points, threads=threads)
    return Known(neighbours, begin(neighbours, None), calm.points, calm.noise, True)
