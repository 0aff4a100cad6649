"""The table of what extraction costs comes out, and its figures hang together."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from mpf_core.experiments.cli import experiment


@pytest.mark.slow
def test_the_quick_form_measures_sparse_against_dense_and_the_precisions(tmp_path: Path) -> None:
    told = CliRunner().invoke(experiment, ["extraction", "--quick", "--out", str(tmp_path)])
    assert told.exit_code == 0, told.output
    assert "`mpf experiment extraction --quick`" in told.output
    rows = {row["what"]: row for row in json.loads((tmp_path / "rows.json").read_text())}
    sparse, full = rows["sparse 64³"], rows["every vertex of 64³"]
    # After so few steps the field is rough everywhere: sparse saves nothing there.
    assert sparse["evaluations"] > 0
    assert full["evaluations"] > 0
    assert sparse["evaluations"] > sparse["crossed cells"]
    assert rows["θ in float32"]["error, largest"] < 1e-5
    assert rows["θ in bfloat16"]["error, median"] > 100 * rows["θ in float32"]["error, median"]
    assert (tmp_path / "field.safetensors").is_file()
