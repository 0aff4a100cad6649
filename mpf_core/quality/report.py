"""What `report.json` tells of one reconstruction."""

from __future__ import annotations

import platform
from dataclasses import asdict
from importlib import metadata
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpf_core.options import Options, options_to_mapping
from mpf_core.quality.metrics import points_to_surface
from mpf_core.quality.topology import topology
from mpf_core.surface.mesh import Mesh

PACKAGES = ("metric-phase-fields", "torch", "numpy", "scipy", "scikit-image", "trimesh")


def surface_report(mesh: Mesh, points: NDArray[np.float64]) -> dict[str, Any]:
    """Topology of the mesh and the distances of the input points to it, in the input's units."""
    return {
        **asdict(topology(mesh)),
        "extents": np.ptp(mesh.vertices, axis=0).tolist(),
        "input_to_surface": asdict(points_to_surface(points, mesh)),
    }


def run_report(options: Options) -> dict[str, Any]:
    """Options, seed and versions: what is needed to repeat the run."""
    versions = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            versions[name] = "not installed"
    return {
        "options": options_to_mapping(options),
        "seed": options.seed,
        "versions": versions,
        "machine": platform.machine(),
    }
