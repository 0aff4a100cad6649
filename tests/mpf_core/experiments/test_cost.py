"""The table of a step's cost comes out, and the plain field is the same field."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch
from click.testing import CliRunner

from mpf_core.experiments.cli import experiment
from mpf_core.experiments.cost import PlainField
from mpf_core.field import MetricPhaseField, Order


@pytest.mark.slow
def test_the_quick_form_measures_both_kinds_of_steps(tmp_path: Path) -> None:
    told = CliRunner().invoke(experiment, ["cost", "--quick", "--out", str(tmp_path / "out")])
    assert told.exit_code == 0, told.output
    assert "`mpf experiment cost --quick" in told.output
    rows = {row["step"]: row for row in json.loads((tmp_path / "out" / "rows.json").read_text())}
    mix, alone, terms = rows["the mix of balanced"], rows["regression"], rows["terms"]
    for row in (alone, terms):
        assert row["ratio"] == pytest.approx(row["plain autograd, ms"] / row["ours, ms"])
        assert row["GFLOP"] > 0
        assert row["our products in"] in ("float32", "bfloat16")
        assert row["loops"] == "fused"
        assert row["share of their rate"] > 0
    assert mix["ours, ms"] == pytest.approx(0.6 * alone["ours, ms"] + 0.52 * terms["ours, ms"])
    # Second derivatives by double backward cost more than those carried along, whatever the size.
    assert terms["ratio"] > 1
    assert rows["float32 products, 2 threads"]["GFLOP/s"] > 0


def test_plain_differentiation_is_of_the_same_field() -> None:
    fields = []
    for kind in (MetricPhaseField, PlainField):
        field = kind(width=16, omega=8.0, generator=torch.Generator().manual_seed(1)).double()
        x = torch.rand(20, 3, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
        fields.append(field(x, Order.LAPLACIAN))
    ours, plain = fields
    for name in ("r", "theta", "phi"):
        one, other = getattr(ours, name), getattr(plain, name)
        for part in ("value", "gradient", "laplacian"):
            assert torch.allclose(getattr(one, part), getattr(other, part), atol=1e-9), name
