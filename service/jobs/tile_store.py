"""A job and its tiles in Redis: they come into being together, and the job waits for them.

While it waits it is `running` without a lease; which tiles it has stands in a list beside its
record.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from redis import Redis

from service.events.store import EVENTS_KEPT, FEED_CHANNEL, stream_key
from service.jobs.index_store import INDEX_PREFIX, QUEUE_PREFIX, RECORD_PREFIX, record_key, text_of
from service.jobs.lease import Changed, Lease
from service.jobs.model import Job, JobProgress, JobState, Tiles
from service.jobs.store import JobStore, changed_by, fields_of
from service.jobs.tile_scripts import SPLIT, TELL

FAMILIES_KEY = "mpf:jobs:tiled"
"""The jobs that have tiles; those that have ended stay here until their tiles are gone."""


def tiles_key(job_id: str) -> str:
    """The list of a job's tiles, in their order."""
    return f"mpf:job:{job_id}:tiles"


@dataclass(frozen=True)
class Sight:
    """One tile as it stands; times in seconds. `weight` is the size of what it fits.

    state: None if its record is gone; took: of one that is fitted
    """

    id: str
    state: JobState | None
    cancel: str = ""
    weight: int = 0
    fraction: float = 0.0
    eta: float | None = None
    points_per_second: float | None = None
    took: float | None = None


@dataclass(frozen=True)
class Family:
    """A job and its tiles, as they were at about the same moment; `seconds` since it started."""

    job: Job | None
    tiles: tuple[Sight, ...]
    seconds: float = 0.0


class TileStore(JobStore):
    """A store of jobs that knows which of them belong together.

    progress_seconds: shortest time between two events of what tiles tell of their job
    """

    def __init__(self, redis: Redis, *, retention_seconds: float, progress_seconds: float = 0.5):
        super().__init__(redis, retention_seconds=retention_seconds)
        self._progress_ms = int(progress_seconds * 1000)
        self._split = redis.register_script(SPLIT)
        self._tell = redis.register_script(TELL)

    def splits(self, lease: Lease) -> None:
        """Note that the running job is being split. Raises Refused."""
        self._apply(
            lease.job_id, None, expect={"lease": lease.token()}, fields={"splitting": True},
            allowed=frozenset({JobState.RUNNING}),
        )  # fmt: skip

    def split(self, lease: Lease, tiles: Sequence[Job]) -> Changed:
        """Let the running job wait for these tiles, which are queued from now on.

        Its lease is over then. Raises Refused: `cancelled` if it is to be given up.
        """
        made = [[tile.id, json.loads(fields_of(_record(tile))), tile.queue] for tile in tiles]
        fields = {"split": lease.attempt, "tiles": asdict(Tiles(len(tiles)))}
        return changed_by(
            self._split(
                keys=[record_key(lease.job_id), tiles_key(lease.job_id), FAMILIES_KEY],
                args=[lease.job_id, lease.token(), fields_of(fields), json.dumps(made),
                      RECORD_PREFIX, INDEX_PREFIX, QUEUE_PREFIX, FEED_CHANNEL],
            )
        )  # fmt: skip

    def join(self, job: Job, tiles: Tiles) -> Changed:
        """`running → queued`: all tiles are fitted. Refused to all but one; the caller enqueues."""
        # What was to be kept is kept; from here on nothing is left to be cut short.
        fields = {"tiles": asdict(tiles), "cancel": ""}
        return self._apply(
            job.id, JobState.QUEUED, expect=_waiting(job) | {"cancel": job.cancel},
            fields=fields, next_attempt=True,
        )  # fmt: skip

    def give_up(self, job: Job, state: JobState, problem: Mapping[str, Any]) -> Changed:
        """`running → failed` or `→ cancelled` of a job whose tiles came to nothing."""
        return self._end(job.id, state, _waiting(job), problem)

    def keep(self, tile_id: str) -> None:
        """Have a tile end with the surface that it has come to, or will have with the least fit."""
        self._apply(
            tile_id, None, expect={}, fields={"cancel": "keep"},
            allowed=frozenset({JobState.QUEUED, JobState.RUNNING}),
        )  # fmt: skip

    def tell(self, job: Job, progress: JobProgress, tiles: Tiles) -> None:
        """Note how far the waiting job is; of no effect once it does not wait any more."""
        self._tell(
            keys=[record_key(job.id), stream_key(job.id)],
            args=[job.id, job.attempt, json.dumps(asdict(progress)), json.dumps(asdict(tiles)),
                  FEED_CHANNEL, EVENTS_KEPT, self._progress_ms],
        )  # fmt: skip

    def families(self) -> list[str]:
        """Ids of the jobs that have tiles."""
        return [text_of(job_id) for job_id in self._redis.smembers(FAMILIES_KEY)]

    def family(self, job_id: str) -> Family:
        """The job and its tiles; one without tiles was not split, or they are gone."""
        listed: Any = self._redis.lrange(tiles_key(job_id), 0, -1)
        ids = [text_of(tile_id) for tile_id in listed]
        if not ids:
            return Family(None, ())
        with self._redis.pipeline(transaction=False) as pipeline:
            pipeline.hget(record_key(job_id), "started_at")
            for tile_id in ids:
                pipeline.hmget(record_key(tile_id), _SEEN)
            started, *found = pipeline.execute()
        tiles = tuple(_sight(tile_id, told) for tile_id, told in zip(ids, found, strict=True))
        seconds = self.now() - int(started) / 1000 if started else 0.0
        # Read after its tiles: one that ended since then belongs to what is seen of the job.
        return Family(self.get(job_id), tiles, max(0.0, seconds))

    def forget_family(self, job_id: str) -> None:
        """There are no tiles of this job any more."""
        with self._redis.pipeline(transaction=True) as pipeline:
            pipeline.delete(tiles_key(job_id))
            pipeline.srem(FAMILIES_KEY, job_id)
            pipeline.execute()


_SEEN = ["state", "cancel", "input", "progress", "started_at", "finished_at"]


def _sight(tile_id: str, told: Sequence[Any]) -> Sight:
    state, cancel, given, progress, started, finished = (
        None if value is None else text_of(value) for value in told
    )
    if state is None:
        return Sight(tile_id, None)
    said = json.loads(progress or "null") or {}
    took = (int(finished) - int(started)) / 1000 if finished and started else None
    done = state == JobState.SUCCEEDED
    return Sight(
        tile_id,
        JobState(state),
        cancel or "",
        weight=(json.loads(given or "null") or {}).get("bytes", 0),
        fraction=1.0 if done else float(said.get("fraction", 0.0)),
        eta=said.get("eta"),
        points_per_second=said.get("points_per_second"),
        took=took if done else None,
    )


def _record(tile: Job) -> dict[str, Any]:
    given = None if tile.input is None else asdict(tile.input)
    return {"id": tile.id, "state": tile.state, "attempt": tile.attempt, "kind": tile.kind,
            "parent": tile.parent, "queue": tile.queue, "owner": tile.owner, "input": given,
            "options": dict(tile.options), "result_attempt": 0, "beats": 0}  # fmt: skip


def _waiting(job: Job) -> dict[str, str]:
    """What must still hold of a job that waits for its tiles."""
    return {"lease": "", "split": str(job.split), "attempt": str(job.split)}
