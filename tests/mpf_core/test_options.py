"""Options as values: presets, the flat form, the schema, and every way to be refused."""

from __future__ import annotations

import json
from dataclasses import FrozenInstanceError, fields, is_dataclass
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mpf_core.errors import OptionsError
from mpf_core.options import (
    PRESET_NAMES,
    PRESETS,
    Options,
    option_fields,
    options_from,
    options_schema,
    options_to_mapping,
)

FIELDS = {declared.name: declared for _, declared in option_fields()}
SCHEMA: dict[str, dict[str, Any]] = options_schema()["properties"]


def value_for(schema: dict[str, Any]) -> st.SearchStrategy[Any]:
    """Values that the schema of one option allows."""
    if "enum" in schema:
        return st.sampled_from(schema["enum"])
    kinds = schema["type"] if isinstance(schema["type"], list) else [schema["type"]]
    low, high = schema.get("minimum"), schema.get("maximum")
    each = {
        "integer": st.integers(low, high),
        "number": st.floats(low, high, allow_nan=False, allow_infinity=False)
        | st.integers(None if low is None else int(-(-low // 1)), high and int(high)),
        "boolean": st.booleans(),
        "string": st.text(),
        "null": st.none(),
    }
    return st.one_of([each[kind] for kind in kinds])


accepted = st.fixed_dictionaries(
    {}, optional={name: value_for(schema) for name, schema in SCHEMA.items()}
)


def test_presets_are_values_with_a_name() -> None:
    assert tuple(sorted(PRESETS)) == tuple(sorted(PRESET_NAMES))
    for name, preset in PRESETS.items():
        assert preset.preset == name
        assert options_from({"preset": name}) == preset
        assert hash(preset) == hash(options_from({"preset": name}))
    with pytest.raises(FrozenInstanceError):
        PRESETS["draft"].seed = 1  # type: ignore[misc]


def test_the_default_is_balanced() -> None:
    assert options_from({}) == Options() == PRESETS["balanced"]


def test_the_paper_preset_adds_nothing_to_the_paper() -> None:
    fit = PRESETS["paper"].fit
    assert (fit.optimizer, fit.schedule, fit.warm_start, fit.denoise) == (
        "adam",
        "constant",
        False,
        "off",
    )
    assert (fit.beta, fit.beta_learning_rate, fit.alpha, fit.softplus_slope) == (50, 1e-4, 100, 100)


@pytest.mark.parametrize("preset", PRESET_NAMES)
def test_one_change_leaves_the_rest_of_the_preset(preset: str) -> None:
    changed = options_to_mapping(options_from({"preset": preset, "omega": 12.5, "resolution": 40}))
    base = options_to_mapping(PRESETS[preset])
    assert {name for name in base if base[name] != changed[name]} == {"omega", "resolution"}


@given(accepted)
def test_what_the_schema_allows_is_accepted_and_comes_back(changes: dict[str, Any]) -> None:
    options = options_from(changes)
    flat = options_to_mapping(options)
    assert set(flat) == set(FIELDS)
    assert all(flat[name] == value for name, value in changes.items())
    assert options_from(flat) == options
    assert options_from(json.loads(json.dumps(flat))) == options


def test_every_preset_satisfies_its_own_schema() -> None:
    for preset in PRESETS.values():
        assert options_from(options_to_mapping(preset)) == preset


def test_the_schema_tells_reason_default_and_group_of_each() -> None:
    assert options_schema()["additionalProperties"] is False
    assert set(SCHEMA) == set(FIELDS)
    for name, schema in SCHEMA.items():
        assert schema["description"].endswith("."), name
        assert schema["default"] == options_to_mapping(Options())[name]
        assert schema["x-group"] in ("job", "fit", "surface", "data", "tile")
    json.dumps(options_schema(), allow_nan=False)


def test_groups_have_no_name_in_common() -> None:
    names = [declared.name for _, declared in option_fields()]
    assert len(names) == len(set(names))
    groups = [f.name for f in fields(Options) if is_dataclass(getattr(Options(), f.name))]
    assert groups == ["fit", "surface", "data", "tile"]


def refused(changes: dict[str, Any], where: str) -> OptionsError:
    with pytest.raises(OptionsError) as told:
        options_from(changes)
    assert told.value.where == where
    assert told.value.advice
    assert where in str(told.value)
    return told.value


@pytest.mark.parametrize("name", sorted(FIELDS))
def test_wrong_types_are_refused(name: str) -> None:
    kind = str(FIELDS[name].type).split(" | ")[0]
    wrong: dict[str, list[Any]] = {
        "int": [1.5, "20", True, [1], {}],
        "float": ["0.5", True, [0.5], {}, float("nan"), float("inf"), -float("inf")],
        "str": [1, 0.5, True, ["a"], "no such choice"],
        "bool": [0, 1, "true", 1.0, []],
    }
    values = wrong[kind]
    if "None" not in str(FIELDS[name].type):
        values.append(None)
    for value in values:
        refused({name: value}, name)


@pytest.mark.parametrize("name", sorted(FIELDS))
def test_bounds_are_allowed_and_what_lies_beyond_is_refused(name: str) -> None:
    low, high = FIELDS[name].metadata["low"], FIELDS[name].metadata["high"]
    kind = str(FIELDS[name].type).split(" | ")[0]
    step: Any = 1 if kind == "int" else 1e-3
    for bound, beyond in ((low, -step), (high, step)):
        if bound is not None:
            value = type(step)(bound)
            assert options_to_mapping(options_from({name: value}))[name] == value
            refused({name: value + beyond}, name)


@pytest.mark.parametrize("name", ["", "fit", "surface", "Seed", "max-iterations", "λ"])
def test_unknown_names_are_refused(name: str) -> None:
    with pytest.raises(OptionsError) as told:
        options_from({name: 1})
    assert told.value.where == name
    assert repr(name) in told.value.message


@pytest.mark.parametrize("preset", ["", "Draft", "best", None, 1, ["draft"], {"a": 1}])
def test_unknown_presets_are_refused_with_the_names_of_those_there_are(preset: Any) -> None:
    error = refused({"preset": preset}, "preset")
    assert all(name in str(error) for name in PRESET_NAMES)


@pytest.mark.parametrize("value", [10**400, -(10**400)], ids=["above", "below"])
def test_whole_numbers_beyond_floating_point_are_refused(value: int) -> None:
    refused({"omega": value}, "omega")
