"""How far a mesh is from a reference mesh, and a cloud from a mesh.

Distances between meshes are taken from area-uniform samples of the one to the *triangles* of the
other, so equal surfaces have distance 0 whatever the number of samples (between two random
n-point samples of one surface of area A the distance would not fall below ½√(A/n)). Lengths are in
the normalised frame: the reference's longest side is 2, the centre of its box the origin.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import igl
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mpf_core.errors import InputError
from mpf_core.quality.sampling import sample_surface
from mpf_core.quality.thickness import DoubleCover, double_cover
from mpf_core.quality.topology import Topology, topology
from mpf_core.surface.cut import pieces
from mpf_core.surface.intersections import self_intersections
from mpf_core.surface.mesh import Mesh
from mpf_core.surface.normals import face_areas, face_normals

SAMPLES = 100_000
F_SCORE_DISTANCES = (0.005, 0.01)


@dataclass(frozen=True)
class Comparison:
    """A mesh against a reference; lengths in the normalised frame of the reference.

    chamfer: 10³ × mean of the two mean distances, mesh → reference and back
    to_reference, to_mesh: those two means × 10³: what is too much, and what is missing
    f_score_005, f_score_010: harmonic mean of the shares of samples, of the mesh and of the
        reference, that lie within 0.005 and 0.01 of the other (0.5 % and 1 % of half the longest
        side)
    normal_consistency: mean |cosine| of the angle between a sample's triangle and the closest
        triangle of the other, both ways halved; blind to orientation
    hausdorff: greatest distance, both ways, over the samples and the vertices; × 1
    samples: on each of the two meshes; scale: one unit of the frame in units of the input
    """

    chamfer: float
    to_reference: float
    to_mesh: float
    f_score_005: float
    f_score_010: float
    normal_consistency: float
    hausdorff: float
    samples: int
    seed: int
    scale: float


@dataclass(frozen=True)
class SurfaceDistances:
    """Distances of points to a surface, in the input's units."""

    mean: float
    median: float
    p95: float
    max: float
    points: int


@dataclass(frozen=True)
class Evaluation:
    """All that `mpf evaluate` tells of a mesh; the double cover in the comparison's frame."""

    comparison: Comparison
    topology: Topology
    self_intersections: int
    cover: DoubleCover

    def as_dict(self) -> dict[str, Any]:
        """The figures as one flat JSON object; `chamfer` and the means are × 10³."""
        flat = asdict(self.comparison) | asdict(self.topology)
        cover = {f"double_{name}": value for name, value in asdict(self.cover).items()}
        return flat | {"self_intersections": self.self_intersections} | cover


def evaluate(mesh: Mesh, reference: Mesh, *, samples: int = SAMPLES, seed: int = 0) -> Evaluation:
    """Every metric of `mesh` against `reference`."""
    return Evaluation(
        comparison=compare(mesh, reference, samples=samples, seed=seed),
        topology=topology(mesh),
        self_intersections=len(self_intersections(mesh)),
        cover=double_cover(_framed(mesh, *_frame_of(reference), "mesh"), seed=seed),
    )


def compare(mesh: Mesh, reference: Mesh, *, samples: int = SAMPLES, seed: int = 0) -> Comparison:
    """Distances of `mesh` and `reference` to each other, from `samples` points on each."""
    center, scale = _frame_of(reference)
    ours, theirs = _framed(mesh, center, scale, "mesh"), _framed(reference, center, scale)
    rng_ours, rng_theirs = np.random.default_rng(seed).spawn(2)
    there = _one_way(ours, theirs, samples, rng_ours)
    back = _one_way(theirs, ours, samples, rng_theirs)
    near, nearer = (_f_score(there, back, within) for within in reversed(F_SCORE_DISTANCES))
    return Comparison(
        chamfer=1e3 * float(there.distances.mean() + back.distances.mean()) / 2,
        to_reference=1e3 * float(there.distances.mean()),
        to_mesh=1e3 * float(back.distances.mean()),
        f_score_005=nearer,
        f_score_010=near,
        normal_consistency=(there.cosine + back.cosine) / 2,
        hausdorff=max(there.greatest, back.greatest),
        samples=samples,
        seed=seed,
        scale=scale,
    )


def point_distances(points: NDArray[np.float64], mesh: Mesh) -> NDArray[np.float64]:
    """(n,) distance of each of `points` (n, 3) to the nearest triangle, in the mesh's units."""
    # Far from the origin (UTM metres) squared coordinates would cost half of the digits.
    origin = mesh.vertices.mean(axis=0) if len(mesh.vertices) else np.zeros(3)
    return _closest(points - origin, Mesh(mesh.vertices - origin, mesh.faces))[0]


def points_to_surface(
    points: NDArray[np.float64], mesh: Mesh, *, at_most: int = 500_000, seed: int = 0
) -> SurfaceDistances:
    """How far `points` (n, 3) lie from the triangles of `mesh`, in the input's units.

    Of a larger cloud `at_most` points are drawn; the result's `points` says how many were measured.
    """
    if len(points) > at_most:
        points = points[np.random.default_rng(seed).permutation(len(points))[:at_most]]
    distances = point_distances(points, mesh)
    median, p95 = np.percentile(distances, [50, 95])
    return SurfaceDistances(
        mean=float(distances.mean()),
        median=float(median),
        p95=float(p95),
        max=float(distances.max()),
        points=len(points),
    )


def farthest_component(mesh: Mesh, samples: cKDTree) -> float:
    """The greatest distance that a component keeps from every sample, in the mesh's units."""
    count, piece = pieces(mesh.faces, len(mesh.vertices))
    closest = np.full(count, np.inf)
    np.minimum.at(closest, piece, samples.query(mesh.vertices)[0])
    return float(closest.max(initial=0.0))


def lines(evaluation: Evaluation) -> list[str]:
    """The figures as a table of text."""
    c, t = evaluation.comparison, evaluation.topology
    rows = [
        ("Chamfer × 10³", f"{c.chamfer:.4g}   point-to-triangle, both ways, halved; floor 0"),
        ("  mesh → reference", f"{c.to_reference:.4g}"),
        ("  reference → mesh", f"{c.to_mesh:.4g}"),
        ("F-score at 0.005", f"{100 * c.f_score_005:.2f} %"),
        ("F-score at 0.01", f"{100 * c.f_score_010:.2f} %"),
        ("normal consistency", f"{c.normal_consistency:.4f}"),
        ("Hausdorff", f"{c.hausdorff:.4g}"),
        ("vertices, faces", f"{t.vertices}, {t.faces}"),
        ("components", f"{t.components}"),
        ("watertight", "yes" if t.watertight else "no"),
        ("Euler characteristic", f"{t.euler_characteristic}"),
        ("boundary edges", f"{t.boundary_edges} in {t.boundary_loops} curves"),
        ("non-manifold", f"{t.nonmanifold_edges} edges, {t.nonmanifold_vertices} vertices"),
        ("inconsistent edges", f"{t.inconsistent_edges}"),
        ("self-intersections", f"{evaluation.self_intersections} pairs of faces"),
        ("double cover", _cover_text(evaluation.cover)),
        ("slivers, degenerate", f"{t.slivers}, {t.degenerate_faces}"),
        ("samples", f"{c.samples} on each mesh, seed {c.seed}"),
        ("frame", f"reference's longest side is 2; one unit is {c.scale:.6g} of the input"),
    ]
    return [f"{name:<22}{value}" for name, value in rows]


def _cover_text(cover: DoubleCover) -> str:
    if cover.thickness is None:
        return "none"
    return f"{100 * cover.share:.1f} % of the area, {cover.thickness:.4g} thick (median)"


@dataclass(frozen=True)
class _OneWay:
    """distances: (n,) of the samples; cosine: mean |cos|; greatest: over samples and vertices."""

    distances: NDArray[np.float64]
    cosine: float
    greatest: float


def _one_way(source: Mesh, target: Mesh, samples: int, rng: np.random.Generator) -> _OneWay:
    drawn = sample_surface(source, samples, rng, stratified=True)
    used = source.vertices[np.unique(source.faces)]
    distances, closest = _closest(np.concatenate([drawn.points, used]), target)
    normals = face_normals(source)[drawn.faces]
    cosines = np.abs((normals * face_normals(target)[closest[:samples]]).sum(axis=1))
    return _OneWay(distances[:samples], float(cosines.mean()), float(distances.max()))


def _closest(
    points: NDArray[np.float64], mesh: Mesh
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Distance of each point to the nearest triangle, and that triangle's index."""
    squared, face, _ = igl.point_mesh_squared_distance(
        np.ascontiguousarray(points, dtype=np.float64),
        np.ascontiguousarray(mesh.vertices),
        np.ascontiguousarray(mesh.faces),
    )
    return np.sqrt(np.maximum(squared, 0)), np.asarray(face, dtype=np.int64)


def _f_score(there: _OneWay, back: _OneWay, within: float) -> float:
    precision = float((there.distances <= within).mean())
    recall = float((back.distances <= within).mean())
    total = precision + recall
    return 2 * precision * recall / total if total > 0 else 0.0


def _frame_of(reference: Mesh) -> tuple[NDArray[np.float64], float]:
    """Centre of the box and half its longest side."""
    if len(reference.faces) == 0:
        raise InputError("the reference mesh has no triangles")
    used = reference.vertices[np.unique(reference.faces)]
    low, high = used.min(axis=0), used.max(axis=0)
    scale = float((high - low).max() / 2)
    if scale <= 0:
        raise InputError("the reference mesh has no extent")
    return (low + high) / 2, scale


def _framed(mesh: Mesh, center: NDArray[np.float64], scale: float, name: str = "reference") -> Mesh:
    framed = Mesh((mesh.vertices - center) / scale, mesh.faces)
    if len(mesh.faces) == 0 or face_areas(framed).sum() <= 0:
        raise InputError(f"the {name} has no triangle with an area")
    return framed
