"""What a worker does for a job in tiles beside the numerics: tiles become jobs, and their results
one."""

from __future__ import annotations

import json
import logging
from collections.abc import Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path

from mpf_core.tiles.count import FIT_BEGINS, FIT_ENDS
from service.artifacts.base import Artifacts, Published, StoreUnavailable
from service.connection import UNREACHABLE
from service.jobs.family import Families, cancelled_problem
from service.jobs.lease import Changed, Lease, Refused
from service.jobs.model import TILE, Artifact, Input, Job, JobState, new_job_id
from service.jobs.queue import JobQueue, queue_for
from service.jobs.tile_store import TileStore
from service.jobs.tiles import require_at_most
from service.settings import Settings
from worker.report import WHOLE, Part
from worker.runners import JOIN, SPLIT, Gathered

log = logging.getLogger("mpf.worker")

PLAN = "plan.json"
TILE_FILES = "tile-"
"""How the names of the files begin that a split leaves, one for each tile."""


class TileWork:
    """For one attempt."""

    def __init__(
        self,
        store: TileStore,
        queue: JobQueue,
        artifacts: Artifacts,
        lease: Lease,
        settings: Settings,
    ):
        self._store = store
        self._queue = queue
        self._artifacts = artifacts
        self._lease = lease
        self._settings = settings
        self._families = Families(store, queue, artifacts)
        self._made: dict[str, str] = {}
        """Ids of the tiles of this attempt by the names of their files."""

    def begin(self, work: str) -> None:
        """Let those who watch the attempt know what it does."""
        if work == SPLIT:
            with suppress(Refused):  # the attempt finds that out by itself
                self._store.splits(self._lease)

    def part(self, job: Job, work: str) -> Part:
        """Which part of its job the attempt is."""
        if work == SPLIT:
            return Part(ends=FIT_BEGINS)
        if work == JOIN:
            return Part(begins=FIT_ENDS)
        if work == TILE:
            return Part(told=partial(self._families.tell, job.parent))
        return WHOLE

    def samples(self, split: Path) -> Mapping[str, int]:
        """How many each tile has that was split into this folder, by the name of its file.

        Raises OptionsError where they are more than one job may have: its points were not counted
        when it came.
        """
        told = json.loads((split / PLAN).read_bytes())["tiles"]
        require_at_most(self._settings.tiles_per_job, len(told))
        return {tile["file"]: int(tile["samples"]) for tile in told}

    def made(
        self, job: Job, files: Mapping[str, Artifact], samples: Mapping[str, int]
    ) -> list[Job]:
        """A job for each tile of what the split has published, with its file as input.

        Called again after StoreUnavailable it makes the same ones.
        """
        return [self._tile(job, name, files[name], samples[name]) for name in sorted(samples)]

    def _tile(self, job: Job, name: str, about: Artifact, samples: int) -> Job:
        given = Input(name, "safetensors", about.bytes, about.sha256, samples)
        tile = Job(
            id=self._made.setdefault(name, new_job_id()),
            state=JobState.QUEUED,
            attempt=1,
            kind=TILE,
            parent=job.id,
            queue=queue_for(TILE, job.options, given, self._settings),
            owner=job.owner,
            options=job.options,
            input=given,
        )
        self._artifacts.share_field(job.id, self._lease.attempt, name, tile.id)
        return tile

    def hand_out(self, tiles: list[Job]) -> Changed:
        """Let the job wait for these tiles; this attempt is over then."""
        try:
            changed = self._store.split(self._lease, tiles)
        except Refused as refusal:
            if refusal.reason != "cancelled":
                raise
            return self._store.cancelled(self._lease, cancelled_problem())
        # One that is not told of now is found by the reaper.
        for tile in tiles:
            self._queue.enqueue(tile, tile.attempt)
        return changed

    def gathered(self, job: Job) -> Gathered | None:
        """What is to be joined, on this machine; None if nothing is.

        Raises FileNotFoundError where a tile is gone, which is where the job is not ours any more.
        """
        if not job.split:
            return None
        family = self._store.family(job.id)
        here = (job.id, self._lease.attempt)
        fitted = []
        for sight in family.tiles:
            tile = self._store.get(sight.id)
            if tile is None:
                raise FileNotFoundError(sight.id)
            result = Published(tile.id, tile.result_attempt)
            fitted.append(self._artifacts.local_result(result, *here))
        # The tiles themselves have served.
        plan = self._artifacts.local_result(Published(job.id, job.split), *here, but=TILE_FILES)
        return Gathered(plan, tuple(fitted))

    def ended(self, job: Job) -> None:
        """This attempt is over: see to what follows for others."""
        with suppress(Refused):
            try:
                self._forget_unborn()
                self._families.look(job.parent if job.kind == TILE else job.id)
            except UNREACHABLE as error:
                log.warning("job %s: what follows is left to the reaper: %s", job.id, error)

    def _forget_unborn(self) -> None:
        """Remove the files of tiles that did not become jobs: another attempt makes its own."""
        with suppress(StoreUnavailable):  # else they are removed by age
            for tile_id in self._made.values():
                if self._store.get(tile_id) is None:
                    self._artifacts.remove(tile_id)
