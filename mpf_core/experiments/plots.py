"""Curves as pictures: Chamfer over time, fields along a line."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from numpy.typing import NDArray

from mpf_core.experiments.trial import Row

_COLORS = ("#24669f", "#b4492b", "#4d8b57", "#8c5aa8", "#c08a1e", "#5b6670")


def chamfer_over_time(rows: Sequence[Row]) -> bytes | None:
    """PNG of the courses in `rows`, one panel for each shape; None where there is none.

    Lines are of the network's own surface on the way; the filled mark is the delivered mesh.
    """
    shapes: dict[str, list[Row]] = {}
    for row in rows:
        if "course" in row:
            shapes.setdefault(row["trial"]["shape"], []).append(row)
    if not shapes:
        return None
    figure = Figure(figsize=(6.2 * len(shapes), 4.4), layout="constrained")
    panels = figure.subplots(1, len(shapes), squeeze=False)[0]
    for panel, (shape, courses) in zip(panels, shapes.items(), strict=True):
        for k, row in enumerate(courses):
            color = _COLORS[k % len(_COLORS)]
            there = [m for m in row["course"] if "chamfer" in m]
            at = [m["seconds"] for m in there]
            label = row["trial"]["label"].removeprefix(f"{shape}, ")
            panel.plot(at, [m["chamfer"] for m in there], "o-", color=color, ms=3.5, label=label)
            if "metrics" in row:
                panel.plot(row["seconds"], row["metrics"]["chamfer"], "D", color=color, ms=7)
        panel.set(xscale="log", yscale="log", title=shape)
        panel.set_xlabel("seconds (line: the network's surface; diamond: the mesh delivered)")
        for axis in (panel.xaxis, panel.yaxis):
            axis.set_major_locator(LogLocator(subs=(1, 2, 3, 5)))
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            axis.set_minor_formatter(NullFormatter())
        panel.set_ylabel("Chamfer × 10³")
        _tidied(panel)
    return _png(figure)


def probes(lines: Mapping[str, tuple[NDArray[np.float64], Mapping[str, NDArray[Any]]]]) -> bytes:
    """PNG of fields along lines, one panel each: title → (position (n,), name → values (n,))."""
    figure = Figure(figsize=(6.2 * len(lines), 4.0), layout="constrained")
    panels = figure.subplots(1, len(lines), squeeze=False)[0]
    for panel, (title, (position, fields)) in zip(panels, lines.items(), strict=True):
        for k, (name, values) in enumerate(fields.items()):
            panel.plot(position, values, color=_COLORS[k], label=name, lw=1.6)
        panel.axhline(0, color="#26282c", lw=0.8)
        panel.set(title=title, xlabel="position, normalised", ylim=(-1.08, 1.08))
        _tidied(panel)
    return _png(figure)


def _tidied(panel: Axes) -> None:
    panel.grid(True, which="major", color="#dddfe2", lw=0.7)
    panel.spines[["top", "right"]].set_visible(False)
    panel.legend(frameon=False, fontsize=9)


def _png(figure: Figure) -> bytes:
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=120)
    return stream.getvalue()
