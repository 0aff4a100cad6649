"""All of it on one machine, tile after tile: split, fit each, join."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

from mpf_core.errors import TileError
from mpf_core.options import Options
from mpf_core.progress import Progress
from mpf_core.tiles.child import FIELD, fit_tile_in_time
from mpf_core.tiles.count import FIT_BEGINS, FIT_ENDS
from mpf_core.tiles.join import BEGINS as JOINING
from mpf_core.tiles.join import TiledReconstruction, joined
from mpf_core.tiles.kept import is_fitted, kept_beside
from mpf_core.tiles.plan import PLAN, Plan, read_plan, read_tile
from mpf_core.tiles.split import split_file
from mpf_core.watch import Watch

# Stages that callers do not know, as those that they do.
STAGE = {"split": "initialize", "fidelity": "extract", "done": "report"}


def reconstruct_tiled(
    cloud_path: str | Path, options: Options, watch: Watch
) -> TiledReconstruction:
    """The surface of a cloud that is fitted in tiles; `time_budget` is that of each.

    Where `watch` has a checkpoint, plan, fitted tiles and the state of the one under way are kept
    in a folder beside it, and taken from there at first; once the result is written the caller
    removes that (`forget_kept`). When `watch.stop` says so, the tile under way ends with what it
    has, and the others are fitted in a hurry. No previews.
    """
    cloud_path = Path(cloud_path)
    with _folder(watch.checkpoint, cloud_path, options) as folder:
        notes: list[str] = []
        plan = _plan(cloud_path, folder, options, watch, notes)
        watch.enter("fit")
        fields = [_fitted(folder, plan, index, options, watch) for index in range(plan.tiles)]
        watch.enter("extract")
        told = _Part(watch, FIT_ENDS, 1.0).told(None)
        inner = Watch(watch.clock, told, watch.cancel, begins=JOINING)
        result = joined(folder, fields, cloud_path, options, inner)
    watch.enter("done")
    watch.seconds |= {name: s for name, s in inner.seconds.items() if name != "read"}
    fit = {**result.report["fit"], "notes": notes}
    report = {**result.report, "fit": fit, "timings": dict(watch.seconds)}
    return replace(result, report=report)


@dataclass(frozen=True)
class _Part:
    """Forwards the progress of a part as that of the whole."""

    outer: Watch
    begin: float
    end: float

    def told(self, stage: str | None, tile: int = 0, tiles: int = 1) -> Callable[[Progress], None]:
        """Takes reports of a part; `stage` in place of theirs where given."""

        def tell(progress: Progress) -> None:
            share = self.begin + progress.fraction * (self.end - self.begin)
            seconds = self.outer.clock() - self.outer.begin
            name = stage or STAGE.get(progress.stage, progress.stage)
            told = replace(progress, stage=name, fraction=share, seconds=seconds, eta=None)
            if progress.iteration is not None and progress.iterations is not None:
                each = progress.iterations
                told = replace(
                    told, iteration=tile * each + progress.iteration, iterations=tiles * each
                )
            self.outer.tell(told)

        return tell


def _plan(cloud_path: Path, folder: Path, options: Options, watch: Watch, notes: list[str]) -> Plan:
    watch.enter("prepare")
    if (folder / PLAN).is_file():
        try:
            plan = read_plan(folder)
            for index, name in enumerate(plan.files):
                if not is_fitted(folder / str(index), options, anyhow=False):
                    read_tile(folder / name)
            return plan
        except (TileError, FileNotFoundError) as error:  # the same cloud gives the same tiles again
            notes.append(f"Kept plan or tiles cannot be read, and are made again: {error}")
    told = _Part(watch, watch.begins["prepare"], FIT_BEGINS).told(None)
    return split_file(
        cloud_path, folder, options, progress=told, cancel=watch.cancel, clock=watch.clock
    )


def _fitted(folder: Path, plan: Plan, index: int, options: Options, watch: Watch) -> Path:
    """The field of a tile, fitted unless it is there already."""
    out = folder / str(index)
    hurry = watch.stop is not None and watch.stop()
    if is_fitted(out, options, anyhow=hurry):
        return out / FIELD
    out.mkdir(exist_ok=True)
    step = (FIT_ENDS - FIT_BEGINS) / plan.tiles
    part = _Part(watch, FIT_BEGINS + index * step, FIT_BEGINS + (index + 1) * step)
    fit_tile_in_time(
        folder / plan.files[index],
        out,
        options,
        progress=part.told("fit", index, plan.tiles),
        stop=watch.stop,
        cancel=watch.cancel,
        checkpoint=out / "checkpoint.safetensors" if watch.checkpoint is not None else None,
        clock=watch.clock,
    )
    return out / FIELD


@contextmanager
def _folder(checkpoint: Path | None, cloud_path: Path, options: Options) -> Iterator[Path]:
    """Where plan, tiles and fields lie: kept beside `checkpoint`, or for as long as the block
    lasts."""
    if checkpoint is not None:
        yield kept_beside(checkpoint, cloud_path, options)
        return
    with TemporaryDirectory(prefix="mpf-tiles-") as name:
        yield Path(name)
