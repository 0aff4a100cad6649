"""The lines of `fields` go through sheet and cube, and the figures hang together."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image

from mpf_core.experiments import fields
from mpf_core.experiments.cli import experiment
from mpf_core.experiments.shapes import distances


def test_the_lines_go_through_the_sheet_and_the_cube() -> None:
    along = np.linspace(-fields.REACH, fields.REACH, 15)
    lines = {
        y: np.stack([0 * along, np.full(15, y), along], axis=1)
        for y in (fields.SHEET_AT, fields.CUBE_AT)
    }
    assert distances(fields.SHAPE, lines[fields.SHEET_AT]) == pytest.approx(
        np.minimum(np.abs(along), distances(fields.SHAPE, lines[fields.SHEET_AT]))
    )
    assert distances(fields.SHAPE, lines[fields.SHEET_AT])[7] == pytest.approx(0, abs=1e-9)
    half = 0.4 * 2 / 1.5  # of the cube's side, the longest of the whole being 1.5
    expected = np.abs(np.abs(along) - half)
    found = distances(fields.SHAPE, lines[fields.CUBE_AT])
    near = expected < 0.4
    assert found[near] == pytest.approx(expected[near])


@pytest.mark.slow
def test_the_quick_form(tmp_path: Path) -> None:
    out = tmp_path / "out"
    told = CliRunner().invoke(experiment, ["fields", "--quick", "--out", str(out)])
    assert told.exit_code == 0, told.output
    sheet, cube = json.loads((out / "rows.json").read_text())
    assert (sheet["line"], cube["line"]) == ("through the sheet", "through the cube")
    probed = json.loads((out / "probes.json").read_text())["through the cube"]
    P, theta, r = (np.array(probed[name]) for name in ("P", "theta", "r"))
    assert (r >= 0).all()
    assert (np.abs(P) <= 1).all()
    phi = np.array(probed["phi"])
    assert np.abs(phi - (r * P + theta)).max() < 1e-4  # rounded to five digits
    assert np.array_equal(np.sign(P[np.abs(theta) > 1e-3]), np.sign(theta[np.abs(theta) > 1e-3]))
    for name in ("sheet.png", "probes.png", "mesh.png"):
        assert Image.open(out / name).size[0] > 500
    assert (out / "mesh.ply").is_file()
    # The field is kept: the second time nothing is fitted.
    before = (out / "field.safetensors").stat().st_mtime_ns
    again = CliRunner().invoke(experiment, ["fields", "--quick", "--out", str(out)])
    assert again.output == told.output
    assert (out / "field.safetensors").stat().st_mtime_ns == before
