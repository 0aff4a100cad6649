"""How far a job is whose cloud is fitted in tiles, by what its tiles tell."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil
from statistics import fmean

from mpf_core.errors import OptionsError
from mpf_core.options import Options
from mpf_core.tiles.count import FIT_BEGINS, FIT_ENDS, tile_count
from service.jobs.model import JobProgress, JobState, Tiles
from service.jobs.tile_store import Family, Sight

SPLIT_SHARE = FIT_BEGINS / (FIT_ENDS - FIT_BEGINS)
JOIN_SHARE = (1 - FIT_ENDS) / (FIT_ENDS - FIT_BEGINS)
"""Time to make a tile, and to take its surface, of the time to fit it."""


def require_few(points: int | None, options: Options, most: int) -> None:
    """Raises OptionsError for a cloud that would be fitted in more than `most` tiles.

    Each is a job beside the limits that hold for jobs. points: None if nobody has counted them
    """
    require_at_most(most, tile_count(points or 0, options))


def require_at_most(most: int, tiles: int) -> None:
    """The same once they are counted."""
    if tiles > most:
        raise OptionsError(
            f"the cloud would be fitted in {tiles} tiles, more than {most}",
            where="tile_points",
            advice="Raise tile_points, or set tiles to off.",
        )


def seconds_of(tiles: int, pace: float, at_once: int) -> float:
    """That a job of so many tiles takes; pace: seconds of one of them, at_once: fitted together."""
    return ceil(tiles / at_once) * pace + tiles * pace * (SPLIT_SHARE + JOIN_SHARE)


def counted(tiles: Sequence[Sight]) -> Tiles:
    """How many there are, are fitted, and are being fitted."""
    states = [tile.state for tile in tiles]
    return Tiles(
        len(tiles), states.count(JobState.SUCCEEDED), states.count(JobState.RUNNING)
    )  # fmt: skip


def progress_of(family: Family) -> JobProgress:
    """What the job tells while it waits: each tile counts by its size."""
    tiles = family.tiles
    whole = sum(tile.weight for tile in tiles) or 1
    done = sum(tile.weight * tile.fraction for tile in tiles) / whole
    rates = [tile.points_per_second for tile in tiles if tile.state is JobState.RUNNING]
    known = [rate for rate in rates if rate is not None]
    return JobProgress(
        stage="fit",
        fraction=FIT_BEGINS + min(1.0, done) * (FIT_ENDS - FIT_BEGINS),
        seconds=family.seconds,
        eta=seconds_left(tiles),
        points_per_second=sum(known) if known else None,
    )


def seconds_left(tiles: Sequence[Sight]) -> float | None:
    """Until the job is done, if as many tiles go on being fitted at a time as now; None: who knows.

    A tile that waits takes as long as the others do, and the surface its share of that.
    """
    took = [tile.took for tile in tiles if tile.took is not None]
    left = {tile.id: tile.eta for tile in tiles if tile.state is JobState.RUNNING}
    # By what the first ones say of themselves as long as none has ended.
    paces = took or [
        tile.eta / (1 - tile.fraction)
        for tile in tiles
        if tile.id in left and tile.eta is not None and tile.fraction < 1
    ]
    if not paces:
        return None
    pace = fmean(paces)
    waiting = sum(tile.state is JobState.QUEUED for tile in tiles)
    fitting = waiting * pace + sum(pace if eta is None else eta for eta in left.values())
    return fitting / max(1, len(left)) + len(tiles) * pace * JOIN_SHARE
