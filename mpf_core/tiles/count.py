"""Into how many tiles a cloud is split; free of torch, so that a service can ask."""

from __future__ import annotations

from mpf_core.options import MOST_TILES, Options


def tile_count(points: int, options: Options) -> int:
    """How many tiles a cloud of so many samples is fitted in; 1: it is one fit.

    A cloud whose file holds duplicates may end up in fewer: its plan says how many.
    """
    if options.tile.tiles == "off" or not options.fit.warm_start:
        return 1
    return min(MOST_TILES, max(1, -(-points // options.tile.tile_points)))
