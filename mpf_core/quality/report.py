"""What `report.json` tells of one reconstruction."""

from __future__ import annotations

import platform
from dataclasses import asdict
from importlib import metadata
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpf_core.cloud.normalize import Similarity
from mpf_core.cloud.prepare import PreparationReport
from mpf_core.options import Options, options_to_mapping
from mpf_core.quality.metrics import points_to_surface
from mpf_core.quality.topology import topology
from mpf_core.surface.edit import Edited
from mpf_core.surface.intersections import self_intersections
from mpf_core.surface.mesh import Mesh
from mpf_core.surface.normals import enclosed_volume, face_areas

COUNTED = 150_000  # faces: some five seconds on one core
PACKAGES = ("metric-phase-fields", "torch", "numpy", "scipy", "scikit-image", "trimesh")


def surface_report(mesh: Mesh, points: NDArray[np.float64]) -> dict[str, Any]:
    """Topology of the mesh, pairs of its triangles that cross, its area and, where it is closed,
    the volume that it encloses (positive: its outside is out); and the distances of the input
    points to it. All in the input's units. Crossing pairs are not counted (null) on meshes of
    more than COUNTED faces, which would take as long as their fit."""
    counts = topology(mesh)
    return {
        **asdict(counts),
        "self_intersections": (
            len(self_intersections(mesh)) if len(mesh.faces) <= COUNTED else None
        ),
        "area": float(face_areas(mesh).sum()),
        "volume": enclosed_volume(mesh) if counts.watertight else None,
        "extents": np.ptp(mesh.vertices, axis=0).tolist(),
        "input_to_surface": asdict(points_to_surface(points, mesh)),
    }


def finished_report(
    final: Edited, points: NDArray[np.float64], fidelity: dict[str, Any]
) -> dict[str, Any]:
    """`surface_report`, and what the last step and the edits after it have done."""
    return {
        **surface_report(final.mesh, points),
        "fidelity": fidelity,
        "double_cover": final.double_cover,
        **final.edits,
    }


def frame_report(similarity: Similarity) -> dict[str, Any]:
    """How the input's frame became the normalised one."""
    return {"center": similarity.center.tolist(), "scale": similarity.scale}


def input_report(
    notes: tuple[str, ...], preparation: PreparationReport, *, noise: float, denoised: bool
) -> dict[str, Any]:
    """The reader's notes, every step of the preparation, and the noise that was found and perhaps
    taken off; lengths in the input's units."""
    density = preparation.density
    return {
        "points": preparation.received,
        "used": preparation.kept,
        "not_finite_dropped": preparation.not_finite_dropped,
        "duplicates_merged": preparation.duplicates_merged,
        "outliers_removed": preparation.outliers_removed,
        "notes": [*notes, *preparation.steps],
        "spacing": density.spacing if density else None,
        "density": density.as_dict() if density else None,
        "noise": noise,
        "denoised": denoised,
    }


def run_report(options: Options) -> dict[str, Any]:
    """Options, seed and versions: what is needed to repeat the run."""
    return {
        "options": options_to_mapping(options),
        "seed": options.seed,
        **versions_report(),
    }


def versions_report() -> dict[str, Any]:
    """What the figures were computed with."""
    versions = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            versions[name] = "not installed"
    return {"versions": versions, "machine": platform.machine()}
