"""A cloud becomes a plan and self-contained tiles; the side of everything is settled here, once."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mpf_core.cloud.neighbors import median_spacing
from mpf_core.cloud.normalize import Similarity
from mpf_core.cloud.pointcloud import PointCloud
from mpf_core.cloud.prepare import PreparationReport, PrepareOptions, prepare
from mpf_core.cloud.reader import read_cloud
from mpf_core.field.blend import Side
from mpf_core.field.partition import Partition
from mpf_core.files import write_atomically
from mpf_core.fit.freespace import HALF_BOX
from mpf_core.fit.inherited import Phase
from mpf_core.fit.initialize import SHELL, Initialization
from mpf_core.heeding import heeding
from mpf_core.known import known_of
from mpf_core.options import Options
from mpf_core.parallel import workers
from mpf_core.progress import CancelCheck, Clock, ProgressCallback
from mpf_core.quality.report import input_report
from mpf_core.tiles.count import tile_count
from mpf_core.tiles.layout import cut_up, places_near, side_of
from mpf_core.tiles.plan import Plan, TileData, tile_bytes, tile_name, write_plan
from mpf_core.watch import Watch

# Share of the splitting that is done when each stage begins.
BEGINS = {"read": 0.0, "prepare": 0.1, "initialize": 0.6, "split": 0.8, "done": 1.0}
MARGIN = 3.0  # voxels of the whole beyond a tile's support from which it has samples: patches and
# rims at the end of the support are then those of the whole
THINNEST = 0.003  # ε, normalised: grids that fit into memory cannot hold thinner shells

Array = NDArray[np.float64]


def split_file(
    cloud_path: str | Path,
    out: str | Path,
    options: Options,
    *,
    progress: ProgressCallback | None = None,
    cancel: CancelCheck | None = None,
    clock: Clock = time.monotonic,
) -> Plan:
    """Read a cloud and write plan.json, side.safetensors and tile-{number}.safetensors to `out`.

    The same cloud and options give the same bytes. plan.json is written last. Memory: the cloud,
    and what a single fit of it would analyse. Raises InputError, Cancelled.
    """
    out = Path(out)
    watch = Watch(clock, progress, cancel, begins=BEGINS)
    threads = options.threads or torch.get_num_threads()
    watch.enter("read")
    cloud = read_cloud(Path(cloud_path))
    with workers(threads), heeding(watch.check):
        watch.enter("prepare")
        cloud, preparation = prepared(cloud, options)
        similarity = Similarity.of(cloud.points)
        samples = similarity.to_normalised(cloud.points)
        spacing = median_spacing(cKDTree(samples), threads)
        known = known_of(samples, options, watch, threads)
        watch.enter("split")
        start = known.start
        assert start is not None
        partition = cut_up(samples, tile_count(len(samples), options), spacing)
        side = side_of(start.space, samples)
        places = _places(partition, side, samples)
        thinnest = min(SHELL / place.frame.scale for place in places)
        whole = _Whole(cloud.points, similarity, start, spacing, max(thinnest, THINNEST))
        out.mkdir(parents=True, exist_ok=True)
        for index, place in enumerate(places):
            watch.check()
            tile = whole.tile(index, len(places), place)
            write_atomically(out / tile_name(index), tile_bytes(tile))
    report = {
        "input": input_report(
            cloud.notes,
            preparation,
            noise=similarity.length_to_input(known.noise),
            denoised=known.denoised,
        ),
        "enclosed_regions": start.space.enclosures,
        "enclosing_share": round(start.seeded, 4),
    }
    counts = tuple(len(place.rows) for place in places)
    shell = similarity.length_to_input(whole.shell)
    plan = Plan(similarity, partition, side, spacing, shell, counts, report)
    write_plan(plan, out)
    watch.enter("done")
    return plan


def prepared(cloud: PointCloud, options: Options) -> tuple[PointCloud, PreparationReport]:
    """The cloud as splitting and joining use it; both must see the same."""
    made = prepare(cloud, PrepareOptions(outlier_sigma=options.fit.outlier_sigma))
    return made.cloud, made.report


@dataclass(frozen=True)
class _Place:
    """A tile in the whole's frame: where it has weight (2, 3), which samples it gets, and its own
    frame, which holds them and all places at which its network will be asked."""

    support: Array
    rows: NDArray[np.int64]
    frame: Similarity


def _places(partition: Partition, side: Side, samples: Array) -> list[_Place]:
    asked = places_near(side)
    margin = MARGIN * side.voxel
    places = []
    for support in partition.boxes(np.array([[-side.half] * 3, [side.half] * 3]), 1.0):
        rows = np.flatnonzero(_within(samples, support, margin))
        held = asked[_within(asked, support, 0.0)]
        corners = [side.voxel / 2 * sign + held for sign in (-1, 1)]
        frame = Similarity.of(np.concatenate([samples[rows], *corners]))
        places.append(_Place(support, rows, frame))
    return places


def _within(x: Array, box: Array, margin: float) -> NDArray[np.bool_]:
    return np.asarray(((x >= box[0] - margin) & (x <= box[1] + margin)).all(1))


@dataclass(frozen=True)
class _Whole:
    """What tiles are cut from: points (n, 3) in the input's frame, the whole's frame and start;
    spacing and ε are normalised."""

    points: Array
    similarity: Similarity
    start: Initialization
    spacing: float
    shell: float

    def tile(self, index: int, tiles: int, place: _Place) -> TileData:
        """All that the fit of one tile needs."""
        frame, support = place.frame, self.similarity.to_input(place.support)
        own = Similarity(
            self.similarity.to_input(frame.center[None])[0], frame.scale * self.similarity.scale
        )
        spacing = self.similarity.length_to_input(self.spacing)
        return TileData(
            index, tiles, self.points[place.rows], own, self._phase(frame), spacing, support
        )

    def _phase(self, frame: Similarity) -> Phase:
        start, space = self.start, self.start.space
        points = start.local.neighbours.points
        box = frame.center + np.array([[-1.0], [1.0]]) * HALF_BOX / frame.scale
        rows = np.flatnonzero(_within(points, box, 0.0))
        # The voxels of the whole around all that a tile's own grid covers.
        index = np.rint((box + HALF_BOX) / space.voxel) + np.array([[-1], [1]])
        low, high = np.clip(index, 0, len(space.labels) - 1).astype(np.int64)
        part = tuple(slice(a, b + 1) for a, b in zip(low, high, strict=True))
        return Phase(
            points=frame.to_normalised(points[rows]),
            normals=start.normals[rows],
            solid=start.bounds.solid[rows],
            buried=start.bounds.buried[rows],
            labels=np.ascontiguousarray(space.labels[part]),
            corner=frame.to_normalised(space.position(low.astype(np.float64))[None])[0],
            voxel=space.voxel * frame.scale,
            shell=self.shell * frame.scale,
            enclosures=space.enclosures,
        )
