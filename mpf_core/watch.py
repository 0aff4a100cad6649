"""How far a reconstruction is: stages, their seconds, and the caller's wish to stop."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from mpf_core.errors import Cancelled
from mpf_core.field import MetricPhaseField
from mpf_core.fit.control import Control, StepReport
from mpf_core.progress import CancelCheck, Clock, PreviewCallback, Progress, ProgressCallback

Snapshot = Callable[[MetricPhaseField], None]

# Seconds that loading the loops takes where they have been compiled before, and what a first run
# is given at most beyond its time budget to compile them.
WARM, MOST_GRANTED = 2.0, 30.0

# Share of the whole job that is done when each stage begins.
BEGINS = {"read": 0.0, "prepare": 0.01, "initialize": 0.03, "fit": 0.08, "extract": 0.85}
BEGINS |= {"report": 0.96, "done": 1.0}


class Watch:
    """Reports progress and keeps the seconds of each stage."""

    def __init__(
        self,
        clock: Clock,
        progress: ProgressCallback | None,
        cancel: CancelCheck | None,
        begin: float | None = None,
        stop: CancelCheck | None = None,
        checkpoint: Path | None = None,
        preview: PreviewCallback | None = None,
        begins: Mapping[str, float] = BEGINS,
    ):
        self.begins = begins
        self.preview = preview
        self.checkpoint = checkpoint
        self.clock, self.progress, self.cancel, self.stop = clock, progress, cancel, stop
        self.begin = clock() if begin is None else begin
        self.stage, self.since = "", self.begin
        self.last_step: StepReport | None = None
        self.seconds: dict[str, float] = {}
        self.granted = 0.0  # seconds beyond the time budget

    def enter(self, stage: str) -> None:
        """Begin a stage; raises Cancelled when the caller wants to stop."""
        now = self.clock()
        if self.stage:
            spent = self.seconds.get(self.stage, 0.0) + now - self.since
            self.seconds[self.stage] = round(spent, 3)
        self.stage, self.since = stage, now
        self.check()
        self.tell(Progress(stage, self.begins[stage], now - self.begin))

    @contextmanager
    def compiling(self) -> Iterator[None]:
        """What a first run spends on its loops within is not taken from the fit."""
        begin = self.clock()
        yield
        self.granted = min(max(self.clock() - begin - WARM, 0.0), MOST_GRANTED)

    def tell(self, progress: Progress) -> None:
        if self.progress is not None:
            self.progress(progress)

    def check(self) -> None:
        if self.cancel is not None and self.cancel():
            raise Cancelled("the reconstruction was cancelled", where=self.stage)

    def control(self, seconds: float, snapshot: Snapshot | None = None) -> Control:
        """What the fit needs of it, with a deadline so many seconds after the beginning."""
        return Control(
            self.clock,
            self.begin + seconds,
            report=self.on_step,
            stop=self.stop,
            cancel=self.cancel,
            snapshot=snapshot,
            checkpoint=self.checkpoint,
        )

    def on_step(self, step: StepReport) -> None:
        """Forward a report from the fit."""
        done = step.iteration / step.planned
        seconds = self.clock() - self.begin
        begin = self.begins["fit"]
        end = min(later for later in self.begins.values() if later > begin)
        fraction = begin + done * (end - begin)
        eta = step.seconds / step.iteration * (step.planned - step.iteration)
        self.tell(
            Progress(
                "fit",
                fraction,
                seconds,
                eta,
                step.iteration,
                step.planned,
                step.loss,
                step.losses,
                self._points_per_second(step),
            )
        )
        self.last_step = step

    def _points_per_second(self, step: StepReport) -> float | None:
        """Since the report before, if there was one."""
        last = self.last_step
        if last is None or step.seconds <= last.seconds:
            return None
        return (step.points - last.points) / (step.seconds - last.seconds)
