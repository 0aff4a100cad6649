"""What a fit tells and what governs it: its reports, its log, and what ends it early."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from mpf_core.field import MetricPhaseField
from mpf_core.progress import CancelCheck, Clock

Values = dict[str, float]


@dataclass(frozen=True)
class StepReport:
    """Where the fit stands after one iteration.

    `losses` are the unweighted terms; `points` counts the samples evaluated by this run.
    """

    iteration: int
    planned: int
    seconds: float
    loss: float
    losses: Values
    points: int = 0


@dataclass
class FitLog:
    """What the fit did, for the report.

    `planned` is the number of iterations that the schedule was laid out for; `stopped_by` one of
    "iterations", "plateau", "clock", "cancel" (the caller's `stop`). A run with
    `--max-iterations planned` and a time budget that does not bind repeats it. `kept` is the
    iteration whose state, or mean of states up to it, was delivered, `resumed_from` the one that a
    checkpoint held; `omega` is ω₀; `precision` that of the hidden products; `loops` "fused" where
    those over single entries were compiled.
    """

    planned: int = 0
    iterations: int = 0
    seconds: float = 0.0
    stopped_by: str = "iterations"
    normal_term: bool = False
    omega: float = 0.0
    precision: str = "float32"
    loops: str = "plain"
    retries: int = 0
    kept: int = 0
    resumed_from: int | None = None
    notes: list[str] = field(default_factory=list)
    history: list[StepReport] = field(default_factory=list)


@dataclass(frozen=True)
class Control:
    """What ends a fit early, who hears of it, and where its state is kept.

    deadline: of `clock`; stop: ends the fit with what it has; cancel: with nothing; snapshot: is
    shown the field now and then; checkpoint: a file to go on from, if there is one, and to keep
    the state in
    """

    clock: Clock
    deadline: float
    report: Callable[[StepReport], None] | None = None
    stop: CancelCheck | None = None
    cancel: CancelCheck | None = None
    snapshot: Callable[[MetricPhaseField], None] | None = None
    checkpoint: Path | None = None
