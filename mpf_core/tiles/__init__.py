"""Scenes larger than one fit: a cloud in overlapping tiles, whose fields are blended into one.

`tile_count` says whether, and into how many (without torch). `split_file` writes a plan and a file
for each tile; `fit_tile_file` fits one of them, anywhere; `join_files` blends their fields and
leaves behind what `reconstruct_file` does. `reconstruct_tiled` does it all in one process.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from mpf_core.tiles.count import tile_count

if TYPE_CHECKING:
    from mpf_core.tiles.child import fit_tile_file
    from mpf_core.tiles.join import join_files
    from mpf_core.tiles.kept import forget_kept
    from mpf_core.tiles.plan import Plan, read_plan
    from mpf_core.tiles.run import reconstruct_tiled
    from mpf_core.tiles.split import split_file

__all__ = [
    "Plan",
    "fit_tile_file",
    "forget_kept",
    "join_files",
    "read_plan",
    "reconstruct_tiled",
    "split_file",
    "tile_count",
]

# What loads torch, and where it is.
_LATE = {
    "Plan": "plan",
    "read_plan": "plan",
    "split_file": "split",
    "fit_tile_file": "child",
    "join_files": "join",
    "forget_kept": "kept",
    "reconstruct_tiled": "run",
}


def __getattr__(name: str) -> Any:
    if name in _LATE:
        return getattr(import_module(f"mpf_core.tiles.{_LATE[name]}"), name)
    raise AttributeError(name)
