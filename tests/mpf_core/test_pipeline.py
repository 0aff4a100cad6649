"""Points in, surface out: the whole pipeline, as small as it can be."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import mpf_core
from mpf_core import Reconstruction, options_from, pipeline, reconstruct, results
from mpf_core.cloud.neighbors import analyse
from mpf_core.errors import Cancelled, CloudError, Collinear, NotFinite, TooLarge, TooSmall
from mpf_core.field.footprint import Footprint
from mpf_core.fit.sampler import warm_pools
from mpf_core.options import Options
from mpf_core.progress import Progress
from mpf_core.surface.edit import edited
from mpf_core.surface.forecast import Forecast, Pace, area_of, shadows_of
from mpf_core.watch import Watch
from tests.mpf_core.clouds import Array, plane, sphere

SMALL: dict[str, Any] = {
    "width": 64,
    "omega": 5.0,  # smooth shapes only, but those within a second
    "max_iterations": 60,
    "resolution": 32,
    "slices": 1,
    "threads": 1,
    "time_budget": 600.0,
    "surface_points": 256,
    "near_points": 256,
    "far_points": 256,
    "start_points": 2048,
}
STAGES = ["prepare", "initialize", "fit", "extract", "report", "done"]


@pytest.fixture(autouse=True)
def _small_pools(monkeypatch: pytest.MonkeyPatch) -> None:
    """Most of a tiny fit's time would go into pools that it hardly draws from."""
    monkeypatch.setattr(pipeline, "warm_pools", partial(warm_pools, size=40_000))


def small(**changes: Any) -> Options:
    return options_from(SMALL | changes)


def test_the_library_is_what_the_package_names() -> None:
    field = {"save_field", "load_field", "extract", "slice_png"}
    cloud = {"Options", "Reconstruction", "options_from", "reconstruct"}
    assert set(mpf_core.__all__) == field | cloud
    assert all(getattr(mpf_core, name) for name in mpf_core.__all__)
    assert mpf_core.reconstruct is pipeline.reconstruct
    with pytest.raises(AttributeError):
        mpf_core.nothing  # noqa: B018


@cache
def _ball() -> Reconstruction:
    return reconstruct(sphere(600, 3.0) + np.array([5.0, 0, 0]), small())


@pytest.fixture
def ball(_small_pools: None) -> Reconstruction:
    return _ball()


def test_a_sphere_becomes_a_closed_mesh_in_its_own_frame(ball: Reconstruction) -> None:
    mesh = ball.mesh
    assert mesh.vertices.dtype == np.float64
    radii = np.linalg.norm(mesh.vertices - [5.0, 0, 0], axis=1)
    assert radii == pytest.approx(3.0, abs=0.3)
    a, b, c = (mesh.vertices[mesh.faces[:, k]] - [5.0, 0, 0] for k in range(3))
    assert np.einsum("fi,fi->", a, np.cross(b, c)) > 0
    assert mesh.normals is not None
    outward = np.einsum("vi,vi->v", mesh.normals, mesh.vertices - [5.0, 0, 0])
    assert (outward > 0).mean() > 0.99


def test_the_report_tells_what_was_done(ball: Reconstruction) -> None:
    report = ball.report
    json.dumps(report, allow_nan=False)
    assert {"options", "seed", "versions", "input", "frame", "fit", "extraction"} <= set(report)
    assert options_from(report["options"]) == small()
    assert report["versions"]["torch"] == torch.__version__
    assert report["input"]["points"] == report["input"]["used"] == 600
    assert report["frame"]["scale"] == pytest.approx(2 / 6, rel=0.01)
    assert report["frame"]["center"] == pytest.approx([5, 0, 0], abs=0.02)
    fit = report["fit"]
    assert (fit["iterations"], fit["stopped_by"], fit["retries"]) == (60, "iterations", 0)
    assert fit["losses"]
    assert fit["history"][-1]["iteration"] == 60
    assert report["extraction"]["resolution"] == 32
    surface = report["surface"]
    assert (surface["watertight"], surface["components"]) == (True, 1)
    assert surface["euler_characteristic"] == 2
    assert surface["self_intersections"] == surface["degenerate_faces"] == 0
    assert surface["area"] == pytest.approx(4 * np.pi * 9, rel=0.2)
    assert surface["volume"] == pytest.approx(4 / 3 * np.pi * 27, rel=0.2)
    assert surface["double_cover"] is None
    assert 0 <= surface["input_to_surface"]["median"] < 0.3
    assert set(report["timings"]) == set(STAGES) - {"done"}


def test_a_mesh_can_be_had_of_one_layer_and_with_fewer_faces(ball: Reconstruction) -> None:
    wish = replace(small().surface, surface_kind="sheet", smoothing=3, max_faces=400)
    final = edited(ball.mesh, wish, ball.fitted)
    assert len(final.mesh.faces) <= 412
    assert final.mesh.normals is not None
    assert final.double_cover is not None  # a ball has one wall only, and stays closed
    assert (final.double_cover["share_of_area"], final.double_cover["closed_solids"]) == (0.0, 1)
    edits = final.edits["decimation"]
    assert edits["faces_before"] == len(ball.mesh.faces)
    assert edits["faces"] == len(final.mesh.faces)
    assert 0 < edits["mean_distance"] < edits["largest_distance"] < 0.3
    assert 0 < final.edits["smoothing"]["mean_distance"] < 0.05
    same = edited(ball.mesh, small().surface, ball.fitted)
    assert same.mesh is ball.mesh


def test_the_same_seed_gives_the_same_mesh(ball: Reconstruction) -> None:
    again = reconstruct(sphere(600, 3.0) + np.array([5.0, 0, 0]), small())
    assert np.array_equal(again.mesh.vertices, ball.mesh.vertices)
    assert np.array_equal(again.mesh.faces, ball.mesh.faces)


def test_progress_names_the_stages_in_order_and_never_goes_back() -> None:
    told: list[Progress] = []
    reconstruct(sphere(200), small(max_iterations=40), progress=told.append)
    assert list(dict.fromkeys(p.stage for p in told)) == STAGES
    fractions = [p.fraction for p in told]
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1
    steps = [p for p in told if p.iteration is not None]
    assert [p.iteration for p in steps] == [20, 40]
    assert all(p.eta is not None and p.loss is not None for p in steps)


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_units_do_not_matter(scale: float) -> None:
    result = reconstruct(sphere(600, 3.0 * scale), small())
    assert np.linalg.norm(result.mesh.vertices, axis=1) == pytest.approx(3 * scale, rel=0.1)
    assert result.report["input"]["spacing"] == pytest.approx(0.25 * scale, rel=1)


def test_a_utm_frame_is_kept_to_the_millimetre() -> None:
    at = np.array([691_607.0, 5_334_760.0, 512.0])
    here, there = (reconstruct(sphere(600, 3.0) + shift, small()) for shift in (0 * at, at))
    moved = there.fitted.similarity.center - here.fitted.similarity.center
    assert moved == pytest.approx(at, abs=1e-6)
    back = there.fitted.similarity.to_normalised(there.mesh.vertices)
    again = there.fitted.similarity.to_input(back)
    assert np.abs(again - there.mesh.vertices).max() < 1e-3
    assert np.abs(
        np.ptp(there.mesh.vertices, axis=0) - np.ptp(here.mesh.vertices, axis=0)
    ).max() < (0.05)


def test_colours_are_carried_over() -> None:
    points = sphere(600)
    colors = np.where(points[:, 2:] > 0, [[255, 0, 0]], [[0, 0, 255]]).astype(np.uint8)
    mesh = reconstruct(points, small(max_iterations=30), colors=colors).mesh
    assert mesh.colors is not None
    assert (mesh.colors[mesh.vertices[:, 2] > 0.3] == [255, 0, 0]).all()
    assert (mesh.colors[mesh.vertices[:, 2] < -0.3] == [0, 0, 255]).all()


def test_two_hundred_points_of_a_plane_give_a_surface() -> None:
    points = np.random.default_rng(0).uniform(-1, 1, size=(200, 3)) * [1, 1, 0]
    result = reconstruct(points, small(resolution=48))
    assert len(result.mesh.faces) > 0
    assert result.report["input"]["used"] == 200
    assert result.report["fit"]["enclosed_regions"] == 0


@pytest.mark.parametrize("normals", ["on", "off"])
def test_a_single_precision_cloud_and_forced_normals_do(normals: str) -> None:
    points = plane(15).astype(np.float32)
    result = reconstruct(points, small(max_iterations=30, normals=normals))
    assert result.report["fit"]["normal_term"] is (normals == "on")


@pytest.mark.parametrize("stage", ["prepare", "initialize", "extract", "report"])
def test_cancel_is_heard_in_every_stage(stage: str) -> None:
    """`cancel` begins to say yes when the stage before has nothing more to report."""
    passed: list[str] = []

    def listen(progress: Progress) -> None:
        if progress.stage != "fit" or progress.iteration == progress.iterations:
            passed.append(progress.stage)
        elif progress.iteration is None:
            passed.append("fit begins")

    before = {"prepare": None, "initialize": "prepare", "extract": "fit", "report": "extract"}[
        stage
    ]
    with pytest.raises(Cancelled):
        reconstruct(
            sphere(200),
            small(max_iterations=2),
            progress=listen,
            cancel=lambda: (passed[-1] if passed else None) == before,
        )
    assert stage not in passed


def test_cancel_in_the_fit_leads_out_of_the_job() -> None:
    steps: list[int] = []

    def listen(progress: Progress) -> None:
        if progress.iteration:
            steps.append(progress.iteration)

    with pytest.raises(Cancelled):
        reconstruct(
            sphere(200),
            small(max_iterations=5000, time_budget=600),
            progress=listen,
            cancel=lambda: bool(steps),
        )
    assert steps == [20]


def test_the_time_budget_holds_for_the_whole_job() -> None:
    looks = iter(range(10**9))
    result = reconstruct(
        sphere(200),
        small(max_iterations=10_000, time_budget=60.0),
        clock=lambda: next(looks) / 10,
    )
    # A tenth of a second a look, and the clock is looked at once an iteration or more.
    assert result.report["fit"]["planned_iterations"] < 480


def test_what_is_kept_for_the_mesh_leaves_the_fit_its_share() -> None:
    """Also where the samples took most of the time, and the mesh would need more than is left."""
    clock = iter((0.0, 0.0, 50.0, 60.0, 70.0))
    watch = Watch(lambda: next(clock), None, None)
    options = small(time_budget=60.0)
    near = analyse(sphere(300))
    footprint = Footprint.of(near.points, spacing=0.1, reach=0.1, thickness=None)
    area, shadows = area_of(near, 0.0), shadows_of(near, 0.0)
    long = Forecast(options.surface, footprint, area, shadows, Pace(1.0, 1.0))
    for kept in (36.0, 6.0, 0.0, 0.0):
        assert pipeline._deadline(60.0, long, watch) == pytest.approx(60.0 - kept)


def test_what_a_first_run_compiles_is_not_taken_from_its_fit() -> None:
    now = [0.0]
    watch = Watch(lambda: now[0], None, None)
    for seconds, granted in ((1.0, 0.0), (12.0, 10.0), (100.0, 30.0)):
        with watch.compiling():
            now[0] += seconds
        assert watch.granted == granted


def test_a_file_becomes_all_artefacts(tmp_path: Path) -> None:
    cloud, out = tmp_path / "cloud.xyz", tmp_path / "new" / "out"
    np.savetxt(cloud, sphere(300))
    report = results.reconstruct_file(cloud, out, small(max_iterations=30, slices=2))
    written = sorted(str(p.relative_to(out)) for p in out.rglob("*") if p.is_file())
    slices = [f"slices/{axis}/{index}.png" for axis in "xyz" for index in (0, 1)]
    assert written == sorted(["field.safetensors", "mesh.glb", "mesh.ply", "report.json", *slices])
    assert json.loads((out / "report.json").read_text("utf-8")) == report
    assert (out / "mesh.glb").read_bytes()[:4] == b"glTF"
    assert (out / "mesh.ply").read_bytes()[:3] == b"ply"
    assert all((out / name).read_bytes().startswith(b"\x89PNG") for name in slices)
    assert "read" in report["timings"]


def line() -> Array:
    return np.linspace(0, 1, 100)[:, None] * [[1.0, 2.0, 3.0]]


@pytest.mark.parametrize(
    ("points", "error"),
    [
        (np.empty((0, 3)), TooSmall),
        (sphere(50), TooSmall),
        (np.repeat(sphere(50), 3, axis=0), TooSmall),
        (line(), Collinear),
        (np.where(np.arange(300)[:, None] == 7, np.nan, sphere(300)), NotFinite),
        (np.full((300, 3), np.inf), NotFinite),
        (np.zeros((300, 3)), CloudError),
    ],
    ids=["none", "few", "repeated", "line", "nan", "infinite", "one place"],
)
def test_clouds_that_make_no_surface_say_why(points: Array, error: type[CloudError]) -> None:
    with pytest.raises(error) as told:
        reconstruct(points, small())
    assert told.value.advice


def test_a_cloud_of_twenty_million_points_is_refused_at_once() -> None:
    with pytest.raises(TooLarge):
        reconstruct(np.zeros((20_000_001, 3), dtype=np.float64), small())
