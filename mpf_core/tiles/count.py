"""Into how many tiles a cloud is split, and how far that is; free of torch, so that a service can
ask."""

from __future__ import annotations

from mpf_core.options import MOST_TILES, Options

# Shares of the whole that are done when its tiles are made, and when they are fitted: those of a
# cloud with one fit (`watch`).
FIT_BEGINS, FIT_ENDS = 0.08, 0.85


def tile_count(points: int, options: Options) -> int:
    """How many tiles a cloud of so many samples is fitted in; 1: it is one fit.

    A cloud whose file holds duplicates may end up in fewer: its plan says how many.
    """
    if options.tile.tiles == "off" or not options.fit.warm_start:
        return 1
    return min(MOST_TILES, max(1, -(-points // options.tile.tile_points)))
