"""All of it on one machine, tile after tile: split, fit each, join."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory

from mpf_core.options import Options, options_to_mapping
from mpf_core.progress import Progress
from mpf_core.tiles.child import FIELD, REPORT, fit_tile_file
from mpf_core.tiles.join import BEGINS as JOINING
from mpf_core.tiles.join import TiledReconstruction, joined
from mpf_core.tiles.plan import PLAN, Plan, read_plan
from mpf_core.tiles.split import split_file
from mpf_core.watch import Watch

# Shares of the whole that are done when tiles begin and when they are joined.
SPLIT, FITTED = 0.08, 0.85
HURRIED = 150  # iterations of tiles that were not begun when the caller wanted to stop: a surface
# Stages that callers do not know, as those that they do.
STAGE = {"split": "initialize", "fidelity": "extract", "done": "report"}


def reconstruct_tiled(
    cloud_path: str | Path, options: Options, watch: Watch
) -> TiledReconstruction:
    """The surface of a cloud that is fitted in tiles; `time_budget` is that of each.

    Where `watch` has a checkpoint, plan, fitted tiles and the state of the one under way are kept
    in a folder beside it, and taken from there at first. When `watch.stop` says so, the tile under
    way ends with what it has, and the others are fitted in a hurry. No previews.
    """
    cloud_path = Path(cloud_path)
    with _folder(watch.checkpoint, cloud_path, options) as folder:
        plan = _plan(cloud_path, folder, options, watch)
        watch.enter("fit")
        fields = [_fitted(folder, plan, index, options, watch) for index in range(plan.tiles)]
        watch.enter("extract")
        told = _Part(watch, FITTED, 1.0).told(None)
        inner = Watch(watch.clock, told, watch.cancel, begins=JOINING)
        result = joined(folder, fields, cloud_path, options, inner)
    watch.enter("done")
    watch.seconds |= {name: s for name, s in inner.seconds.items() if name != "read"}
    return replace(result, report={**result.report, "timings": dict(watch.seconds)})


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


def _plan(cloud_path: Path, folder: Path, options: Options, watch: Watch) -> Plan:
    watch.enter("prepare")
    if (folder / PLAN).is_file():
        return read_plan(folder)
    told = _Part(watch, watch.begins["prepare"], SPLIT).told(None)
    return split_file(
        cloud_path, folder, options, progress=told, cancel=watch.cancel, clock=watch.clock
    )


def _fitted(folder: Path, plan: Plan, index: int, options: Options, watch: Watch) -> Path:
    """The field of a tile, fitted unless it is there already."""
    out = folder / str(index)
    if (out / REPORT).is_file():
        return out / FIELD
    out.mkdir(exist_ok=True)
    step = (FITTED - SPLIT) / plan.tiles
    part = _Part(watch, SPLIT + index * step, SPLIT + (index + 1) * step)
    hurry = watch.stop is not None and watch.stop()
    if hurry:
        few = min(HURRIED, options.fit.max_iterations)
        options = replace(options, fit=replace(options.fit, max_iterations=few))
    fit_tile_file(
        folder / plan.files[index],
        out,
        options,
        progress=part.told("fit", index, plan.tiles),
        stop=None if hurry else watch.stop,
        cancel=watch.cancel,
        checkpoint=out / "checkpoint.safetensors" if watch.checkpoint is not None else None,
        clock=watch.clock,
    )
    return out / FIELD


@contextmanager
def _folder(checkpoint: Path | None, cloud_path: Path, options: Options) -> Iterator[Path]:
    """Where plan, tiles and fields lie: for as long as the block lasts, or beside `checkpoint`
    until it ends without an error. Named by cloud and options, it is never another run's."""
    if checkpoint is None:
        with TemporaryDirectory(prefix="mpf-tiles-") as name:
            yield Path(name)
        return
    base = checkpoint.with_name(f"{checkpoint.name}.tiles")
    folder = base / _name(cloud_path, options)
    if not folder.is_dir():
        shutil.rmtree(base, ignore_errors=True)
        folder.mkdir(parents=True)
    yield folder
    shutil.rmtree(base, ignore_errors=True)


def _name(cloud_path: Path, options: Options) -> str:
    """A digest of all that plan and fields depend on; budgets say when a fit ends, not how it
    goes."""
    settings = options_to_mapping(options)
    settings.pop("time_budget")
    settings["version"] = version("metric-phase-fields")
    digest = hashlib.sha256(json.dumps(settings, sort_keys=True).encode())
    with cloud_path.open("rb") as file:
        while block := file.read(2**20):
            digest.update(block)
    return digest.hexdigest()[:24]
