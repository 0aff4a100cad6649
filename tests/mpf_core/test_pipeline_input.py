"""What a reconstruction's report says about its input."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from mpf_core.options import options_from
from mpf_core.results import reconstruct_file


def test_every_step_of_the_preparation_stands_in_the_report(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    sphere = rng.normal(size=(1200, 3))
    sphere /= np.linalg.norm(sphere, axis=1, keepdims=True)
    rows = [*sphere, *sphere[:5], (9.0, 9.0, 9.0), (float("nan"), 0.0, 0.0)]
    cloud = tmp_path / "scan.csv"
    cloud.write_text("x,y,z\n" + "".join(",".join(map(repr, map(float, r))) + "\n" for r in rows))
    options = options_from(
        {"max_iterations": 2, "width": 16, "resolution": 16, "slices": 0, "outlier_sigma": 10}
    )
    reconstruct_file(cloud, tmp_path / "out", options)
    found = json.loads((tmp_path / "out" / "report.json").read_text())
    told = found["input"]
    assert (told["points"], told["used"]) == (1207, 1200)
    assert told["not_finite_dropped"] == 1
    assert told["duplicates_merged"] == 5
    assert told["outliers_removed"] == 1
    assert 0.05 < told["spacing"] < 0.15
    assert told["density"]["dense"] < told["density"]["sparse"]
    assert told["density"]["normal_reliability"] > 0.9
    assert found["fit"]["normal_reliability"] > 0.9
    notes = "\n".join(told["notes"])
    for said in ("columns: x → x", "1 points with NaN", "5 exact duplicates", "1 outliers",
                 "1200 points kept", "spacing", "density", "normals"):  # fmt: skip
        assert said in notes
    assert found["options"]["outlier_sigma"] == 10.0
