"""What follows for a job from its tiles, and for them from it: a look that may be had at any time.

Whoever sees a tile end looks, and so does whoever cancels or removes the job; the reaper looks at
all families every few seconds, and so finds what a crash has left half done. Each change is fenced,
so that any number of looks at the same time do what one does.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from service.artifacts.base import Artifacts, StoreUnavailable
from service.jobs.lease import Refused
from service.jobs.model import Job, JobState
from service.jobs.queue import JobQueue
from service.jobs.tile_store import Family, Sight, TileStore
from service.jobs.tiles import counted, progress_of
from service.problems import Problem

log = logging.getLogger("mpf.tiles")


class Families:
    """Jobs whose clouds are fitted in tiles."""

    def __init__(self, store: TileStore, queue: JobQueue, artifacts: Artifacts):
        self._store = store
        self._queue = queue
        self._artifacts = artifacts

    def look_at_all(self) -> None:
        """Do for each family what is due."""
        for job_id in self._store.families():
            self.look(job_id)

    def look(self, job_id: str, *, files: bool = True) -> None:
        """Join when all are fitted, end when one came to nothing, remove what nobody needs.

        files: also those of the tiles; without that they are left to a later look, for they are
        many, and an object store is slow
        """
        family = self._store.family(job_id)
        if not family.tiles:
            return
        job = family.job
        if job is None or job.ended:
            self._remove_tiles(family)
            if files:
                self._remove_files(job_id, job, family)
        elif job.in_tiles:
            with suppress(Refused):  # another look was first
                self._look_at_waiting(job, family, files)

    def tell(self, job_id: str) -> None:
        """Have the job say how far its tiles are."""
        family = self._store.family(job_id)
        if family.job is not None and family.job.in_tiles:
            self._store.tell(family.job, progress_of(family), counted(family.tiles))

    def _look_at_waiting(self, job: Job, family: Family, files: bool) -> None:
        tiles = counted(family.tiles)
        ended = _end_of(job, family.tiles, self._store)
        if ended is not None:
            state, problem = ended
            self._store.give_up(job, state, problem)
            log.info("job %s: %s with one of its tiles", job.id, state)
            self.look(job.id, files=files)
        elif tiles.done == tiles.total:
            changed = self._store.join(job, tiles)
            log.info("job %s: its %d tiles are fitted", job.id, tiles.total)
            joining = self._store.get(job.id)
            if joining is not None and joining.attempt == changed.attempt:
                self._queue.enqueue(joining, changed.attempt)
        else:
            if job.cancel == "keep":
                self._keep(family)
            self._store.tell(job, progress_of(family), tiles)

    def _keep(self, family: Family) -> None:
        for tile in family.tiles:
            if tile.cancel != "keep":
                with suppress(Refused):  # it has ended
                    self._store.keep(tile.id)

    def _remove_tiles(self, family: Family) -> None:
        """The job has ended: a tile that still runs loses its lease, and its process is killed."""
        for tile in family.tiles:
            found = self._store.get(tile.id)
            if found is not None:
                self._store.remove(found)
                self._queue.withdraw(found.id, found.attempt)

    def _remove_files(self, job_id: str, job: Job | None, family: Family) -> None:
        # Files that stay behind are those of nobody, and removed by age.
        with suppress(StoreUnavailable):
            for tile in family.tiles:
                self._artifacts.remove(tile.id)
            if job is not None:
                self._artifacts.forget_results(job_id, but=job.result_attempt)
        self._store.forget_family(job_id)


def _end_of(
    job: Job, tiles: tuple[Sight, ...], store: TileStore
) -> tuple[JobState, Mapping[str, Any]] | None:
    """How the job ends with its tiles as they are; None while they may come to something."""
    if job.cancel == "discard":
        return JobState.CANCELLED, cancelled_problem()
    for number, tile in enumerate(tiles, start=1):
        if tile.state is JobState.FAILED:
            found = store.get(tile.id)
            told = dict(found.problem or {}) if found is not None else {}
            here = f"tile {number} of {len(tiles)}"
            return JobState.FAILED, told | {"where": told.get("where") or here}
        if tile.state is JobState.CANCELLED:
            return JobState.CANCELLED, cancelled_problem()
        if tile.state is None or tile.state is JobState.EXPIRED:
            lost = Problem("job.crashed", f"tile {number} of {len(tiles)} was lost")
            return JobState.FAILED, lost.as_dict()
    return None


def cancelled_problem() -> Mapping[str, Any]:
    """Why a cancelled job has no result."""
    return Problem("cancelled", "the job was cancelled by its owner").as_dict()
