"""What may be asked of a fitted field, and what is said of everything else."""

from __future__ import annotations

import json
from typing import Any

import pytest

from mpf_core.errors import OptionsError
from mpf_core.extraction_options import (
    MOST_PICTURES,
    Cuts,
    extraction_from,
    extraction_schema,
    extraction_to_mapping,
    inherited,
)
from mpf_core.options import options_from, options_to_mapping

GIVEN: dict[str, Any] = {
    "resolution": 64,
    "threads": 2,
    "cuts": [
        {"axis": "z", "field": "theta", "at": [0.5, -3]},
        {"axis": "x", "count": 32},
    ],
}


def test_what_is_asked_for_goes_through_json_and_back() -> None:
    options = extraction_from(GIVEN)
    assert (options.surface.resolution, options.surface.slices, options.threads) == (64, 0, 2)
    assert options.mesh
    assert options.cuts == (Cuts("theta", "z", (0.5, -3.0)), Cuts("phi", "x", count=32))
    told = json.loads(json.dumps(extraction_to_mapping(options)))
    assert extraction_from(told) == options
    assert set(told) == set(extraction_schema()["properties"])


def test_nothing_named_is_a_mesh_at_the_chosen_resolution() -> None:
    options = extraction_from({})
    assert (options.mesh, options.cuts, options.surface.resolution) == (True, (), None)


def test_a_fit_hands_on_its_surface_options_but_for_the_stack() -> None:
    fit = options_to_mapping(options_from({"resolution": 40, "slices": 7, "omega": 20.0}))
    kept = inherited(fit)
    assert (kept["resolution"], kept["slices"]) == (40, 0)
    assert "omega" not in kept
    assert inherited(extraction_to_mapping(extraction_from(kept))) == kept


@pytest.mark.parametrize(
    ("given", "where"),
    [
        ({"omega": 30.0}, "omega"),
        ({"preset": "draft"}, "preset"),
        ({"resolution": 3}, "resolution"),
        ({"threads": 0}, "threads"),
        ({"mesh": 1}, "mesh"),
        ({"mesh": False}, "mesh"),
        ({"cuts": {}}, "cuts"),
        ({"cuts": ["z"]}, "cuts"),
        ({"cuts": [{}]}, "cuts[0].axis"),
        ({"cuts": [{"axis": "w", "count": 1}]}, "cuts[0].axis"),
        ({"cuts": [{"axis": ["x"], "count": 1}]}, "cuts[0].axis"),
        ({"cuts": [{"axis": "x", "field": "psi", "count": 1}]}, "cuts[0].field"),
        ({"cuts": [{"axis": "x"}]}, "cuts[0]"),
        ({"cuts": [{"axis": "x", "at": [0], "count": 1}]}, "cuts[0]"),
        ({"cuts": [{"axis": "x", "count": 1, "size": 3}]}, "cuts[0]"),
        *(({"cuts": [{"axis": "x", "at": at}]}, "cuts[0].at") for at in ([], 0.5, ["0"], [True])),
        *(
            ({"cuts": [{"axis": "x", "at": [at]}]}, "cuts[0].at")
            for at in (float("nan"), float("inf"), 10**400)
        ),
        *(({"cuts": [{"axis": "x", "count": n}]}, "cuts[0].count") for n in (0, True, 1.0, "1")),
        ({"cuts": [{"axis": "x", "count": MOST_PICTURES + 1}]}, "cuts"),
        ({"cuts": [{"axis": "x", "count": 300}] * 2}, "cuts"),
        ({"cuts": [{"axis": "x", "at": [0]}] * 1000}, "cuts"),
    ],
    ids=lambda value: str(value)[:60],
)
def test_everything_else_is_refused_with_its_place(given: dict[str, Any], where: str) -> None:
    with pytest.raises(OptionsError) as told:
        extraction_from(given)
    assert told.value.where == where
    assert told.value.advice
