"""From files to files: what a reconstruction leaves behind."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from mpf_core.cloud.reader import read_cloud
from mpf_core.options import Options
from mpf_core.outputs import Result, write_result
from mpf_core.pipeline import reconstruct_cloud
from mpf_core.progress import CancelCheck, Clock, PreviewCallback, ProgressCallback
from mpf_core.tiles import forget_kept, reconstruct_tiled, tile_count
from mpf_core.watch import Watch


def reconstruct_file(
    cloud_path: Path,
    out: Path,
    options: Options,
    *,
    progress: ProgressCallback | None = None,
    stop: CancelCheck | None = None,
    cancel: CancelCheck | None = None,
    checkpoint: Path | None = None,
    preview: PreviewCallback | None = None,
    clock: Clock = time.monotonic,
) -> dict[str, Any]:
    """Read a cloud and write mesh.glb, mesh.ply, field.safetensors, slices/{axis}/{index}.png and
    report.json.

    `stop` ends the fit and takes the surface that it has come to; `cancel` ends everything.
    The state of the fit is kept in the file `checkpoint` every 15 s, and taken from it at first
    where it holds one of the same cloud, options and threads: the result is then the same as
    without the interruption. A file that cannot be used is told of in the report.
    `preview` gets a coarse mesh of the unfinished field as GLB every few seconds.
    A cloud of too many samples for one fit is fitted in tiles, without previews, and its state kept
    in a folder beside `checkpoint`.
    Returns the report. Raises InputError, FitError, SurfaceError, Cancelled.
    """
    watch = Watch(clock, progress, cancel, stop=stop, checkpoint=checkpoint, preview=preview)
    report = write_result(reconstructed(cloud_path, options, watch), out, options)
    if checkpoint is not None:
        forget_kept(checkpoint)
    return report


def reconstructed(cloud_path: Path, options: Options, watch: Watch) -> Result:
    """The same without writing, in one fit or in tiles; what is kept of these stays."""
    watch.enter("read")
    cloud = read_cloud(cloud_path)
    if tile_count(len(cloud), options) == 1:
        return reconstruct_cloud(cloud, options, watch)
    del cloud
    return reconstruct_tiled(cloud_path, options, watch)
