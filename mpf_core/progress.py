"""What a long computation tells its caller, and how the caller stops it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Progress:
    """One report from a running reconstruction.

    `stage` is one of STAGES; `fraction` in [0, 1] is of the whole job, not of the stage; times in
    seconds. `losses` holds the unweighted terms of the last reported step; `points_per_second`
    counts the samples at which the fit evaluated its field since the report before.
    """

    stage: str
    fraction: float
    seconds: float
    eta: float | None = None
    iteration: int | None = None
    iterations: int | None = None
    loss: float | None = None
    losses: Mapping[str, float] = field(default_factory=dict)
    points_per_second: float | None = None


STAGES = ("read", "prepare", "initialize", "fit", "extract", "report")

ProgressCallback = Callable[[Progress], None]
CancelCheck = Callable[[], bool]
Clock = Callable[[], float]  # seconds, from any beginning
PreviewCallback = Callable[[bytes], None]
