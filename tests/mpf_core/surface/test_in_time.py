"""Extraction keeps to the time left: rather coarser, or without the last step, than late."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from mpf_core.cloud.neighbors import analyse
from mpf_core.cloud.normalize import Similarity
from mpf_core.field import MetricPhaseField
from mpf_core.field.fitted import FittedField
from mpf_core.field.footprint import Footprint
from mpf_core.options import LOWEST_RESOLUTION, DataOptions, SurfaceOptions
from mpf_core.quality.topology import topology
from mpf_core.surface import forecast
from mpf_core.surface.extraction import extract_mesh
from mpf_core.surface.fidelity import onto_data
from mpf_core.surface.forecast import Forecast, Pace, Until
from mpf_core.surface.lattice import Evaluate
from tests.mpf_core.clouds import sphere
from tests.mpf_core.surface.shells import start_of

OPTIONS = SurfaceOptions()
POINTS = 0.8 * sphere(4000)


@dataclass(frozen=True)
class Ball(FittedField):
    """A field whose surface is a ball's; torn, it has as many waves as make it three times one."""

    torn: bool = False

    def level(self) -> Evaluate:
        def level(x: np.ndarray) -> np.ndarray:
            waves = 0.6 * np.sin(8 * x).prod(1) if self.torn else 0.0
            return (np.linalg.norm(x, axis=1) - 0.8 + waves).astype(np.float32)

        return level


def field(*, torn: bool = False) -> Ball:
    spacing = analyse(POINTS).median_spacing
    footprint = Footprint.of(POINTS, spacing=spacing, reach=spacing / 2, thickness=None)
    box = np.array([np.full(3, -1.1), np.full(3, 1.1)])
    return Ball(MetricPhaseField(width=8), Similarity(np.zeros(3), 1.0), box, footprint, torn)


def until(fitted: FittedField, share: float) -> Until:
    """The end after a share of what the extraction is foretold to take."""
    near = analyse(POINTS)
    area, shadows = forecast.area_of(near, 0.0), forecast.shadows_of(near, 0.0)
    told = Forecast(OPTIONS, fitted.footprint, area, shadows, Pace(1e-5, 5e-6))
    return Until(told, lambda: 0.0, share * told.seconds(told.fineness))


def test_in_time_the_grid_is_as_fine_as_without_an_end() -> None:
    fitted = field()
    free, held = (extract_mesh(fitted, OPTIONS, until=u) for u in (None, until(fitted, 1.0)))
    assert held.report == free.report
    assert held.report["perforations_closed"] == 0
    assert np.array_equal(held.mesh.vertices, free.mesh.vertices)


def test_a_torn_surface_is_taken_on_a_coarser_grid_and_the_report_says_so() -> None:
    fitted = field(torn=True)
    end = until(fitted, 2.0)
    wanted = end.forecast.fineness.cells
    found = extract_mesh(fitted, OPTIONS, until=end)
    cells = found.report["resolution"]
    assert LOWEST_RESOLUTION < cells < wanted
    assert found.report["reason"].startswith(f"{cells} cells instead of {wanted}")
    assert topology(found.mesh).boundary_edges == 0


@pytest.mark.parametrize("resolution", [None, 100])
def test_too_late_it_is_as_coarse_as_can_be_unless_it_was_asked_for(resolution: int | None) -> None:
    options = SurfaceOptions(resolution=resolution)
    found = extract_mesh(field(), options, until=until(field(), -1.0))
    assert found.report["resolution"] == (resolution or LOWEST_RESOLUTION)
    assert found.report["perforations_closed"] is None  # nobody has looked for any


def test_a_last_step_that_would_end_too_late_is_not_taken() -> None:
    fitted = field()
    mesh = extract_mesh(fitted, OPTIONS).mesh
    clock = iter(range(10**6))
    begun = start_of(POINTS)

    def moved(end: float):  # type: ignore[no-untyped-def]
        return onto_data(
            mesh, fitted.similarity, begun, DataOptions(), spacing=0.05, threads=1,
            clock=lambda: float(next(clock)), end=end,
        )  # fmt: skip

    same, report = moved(1.0)
    assert same is mesh and not report["applied"]
    assert report["reason"] == "there was no time left for it"
    assert moved(np.inf)[1]["applied"]
