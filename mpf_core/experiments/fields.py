"""The four fields of a fit through a cube and the sheet on it: `mpf experiment fields`.

A cut through both across x, and two lines in it: one through the sheet, one through the cube.
"""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from mpf_core.experiments import plots
from mpf_core.experiments.asked import Asked
from mpf_core.experiments.build import Floats
from mpf_core.experiments.shapes import sample, shape
from mpf_core.experiments.tables import stacked
from mpf_core.experiments.trial import Row
from mpf_core.field.artefact import load_field, save_field
from mpf_core.field.fitted import FittedField, field_of
from mpf_core.files import write_atomically
from mpf_core.options import options_from
from mpf_core.pipeline import reconstruct
from mpf_core.quality.metrics import point_distances
from mpf_core.quality.render import render, side_by_side
from mpf_core.surface.drawing import png_bytes
from mpf_core.surface.export import write_ply
from mpf_core.surface.slices import cut

SHAPE, POINTS = "cube-sheet", 10_000
NAMES = {"r": "r", "theta": "θ", "P": "P", "phi": "φ"}
CAPTIONS = {
    "r": "r: how far",
    "theta": "θ: on which side",
    "P": "P = tanh(βθ): the side, bounded",
    "phi": "φ = r·P + θ: both",
}
ACROSS = "x"  # a cut at x = 0 meets the cube, |z| < 0.53, and the sheet, z = 0, edge on
SHEET_AT, CUBE_AT = 0.55, -0.45  # y of the two lines, in the shape's frame
REACH = 0.7  # half the length of a line
PROBES = 1401
WITHIN = 0.05  # from the exact surface: where slopes are compared


def measured(directory: Path, asked: Asked) -> list[Row]:
    """The rows of the table; writes the field, the mesh and the pictures to `directory`."""
    fitted = _fitted(directory, asked)
    lines = {"through the sheet": SHEET_AT, "through the cube": CUBE_AT}
    along = np.linspace(-REACH, REACH, PROBES)
    drawn: dict[str, tuple[NDArray[np.float64], dict[str, NDArray[Any]]]] = {}
    rows: list[Row] = []
    probed: dict[str, dict[str, list[float]]] = {}
    for title, y in lines.items():
        points = np.stack([np.zeros(PROBES), np.full(PROBES, y), along], axis=1)
        values = _values(fitted, points)
        drawn[title] = along, {NAMES[name]: v for name, v in values.items()}
        rows.append({"line": title, **_figures(values, points, along)})
        probed[title] = {"z": _rounded(along)} | {n: _rounded(v) for n, v in values.items()}
    write_atomically(directory / "probes.json", json.dumps(probed).encode())
    write_atomically(directory / "probes.png", plots.probes(drawn))
    write_atomically(directory / "sheet.png", png_bytes(_cuts(fitted)))
    return rows


def _fitted(directory: Path, asked: Asked) -> FittedField:
    path = directory / "field.safetensors"
    if not path.is_file():
        directory.mkdir(parents=True, exist_ok=True)
        options = options_from(asked.options({"slices": 0}))
        result = reconstruct(sample(SHAPE, 3000 if asked.quick else POINTS, 0), options)
        write_ply(result.mesh, directory / "mesh.ply")
        write_atomically(directory / "mesh.png", png_bytes(render(result.mesh)))
        save_field(result.fitted, path)
    return load_field(path)


def _values(fitted: FittedField, points: Floats) -> dict[str, NDArray[np.float64]]:
    """The fields at points (n, 3) of the shape's frame; lengths in that frame."""
    at = fitted.similarity.to_normalised(points)
    unit = 1 / fitted.similarity.scale
    found = {}
    for name in NAMES:
        value = field_of(fitted.field, name)(at).astype(np.float64)
        found[name] = value if name == "P" else value * unit
    return found


def _figures(
    values: dict[str, NDArray[np.float64]], points: Floats, along: NDArray[np.float64]
) -> dict[str, Any]:
    exact = point_distances(points, shape(SHAPE))
    near = exact < WITHIN
    off = np.abs(values["r"] - exact)[near]
    theta = values["theta"]
    change = np.flatnonzero(np.diff(np.sign(theta)) != 0)
    step = theta[change] / (theta[change] - theta[change + 1])
    roots = along[change] + step * (along[change + 1] - along[change])
    slope = np.abs(np.gradient(values["phi"], along))
    return {
        "θ = 0 at z": [round(float(root), 4) for root in roots],
        f"mean error of r × 10³ within {WITHIN}": 1e3 * float(off.mean()),
        "mean absolute P beyond": float(np.abs(values["P"])[~near].mean()),
        f"median slope of φ within {WITHIN}": float(np.median(slope[near])),
    }


def _cuts(fitted: FittedField) -> Image.Image:
    pictures, captions = [], []
    at = float(fitted.similarity.to_normalised(np.zeros((1, 3)))[0, 0])
    for name in NAMES:
        evaluate = field_of(fitted.field, name)
        taken = cut(evaluate, fitted.similarity, fitted.box, ACROSS, at, field=name)
        pictures.append(Image.open(io.BytesIO(taken.picture)).convert("RGB"))
        captions.append(CAPTIONS[name])
    pairs = (slice(0, 2), slice(2, 4))
    return stacked([side_by_side(pictures[k], captions[k]) for k in pairs])


def _rounded(values: NDArray[np.float64]) -> list[float]:
    return [round(float(v), 5) for v in values]
