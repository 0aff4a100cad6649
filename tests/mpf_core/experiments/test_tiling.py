"""The comparison of tiles with one fit comes out, and its figures hang together."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from mpf_core.experiments.cli import experiment


@pytest.mark.slow
def test_the_quick_form_compares_one_fit_with_tiles(tmp_path: Path) -> None:
    told = CliRunner().invoke(experiment, ["tiles", "--quick", "--out", str(tmp_path)])
    assert told.exit_code == 0, told.output
    assert "`mpf experiment tiles --quick`" in told.output
    one, tiles = json.loads((tmp_path / "rows.json").read_text())
    assert (one["tiles"], tiles["tiles"]) == (1, 2)
    assert (one["iterations"], tiles["iterations"]) == (60, 120)
    for row in (one, tiles):
        assert 100 < row["peak MiB"] < 4096
        assert row["seconds"] > 0
        assert 0 < row["Chamfer × 10³"] < 100
        assert 0 < row["alone Chamfer × 10³"] < 100
    assert tiles["error in ramps"] > 0
    assert "error in ramps" not in one
    assert (tmp_path / "tiles" / "field.safetensors").is_file()
