"""One option as a dataclass field: its reason, bounds and unit; its JSON Schema; its check."""

from __future__ import annotations

import math
from dataclasses import Field, field
from typing import Any

from mpf_core.errors import OptionsError


def option(
    default: Any,
    reason: str,
    *,
    low: float | None = None,
    high: float | None = None,
    choices: tuple[str, ...] | None = None,
    unit: str | None = None,
    expert: bool = True,
) -> Any:
    """A dataclass field with reason, bounds and unit; forms fold the `expert` ones away."""
    metadata = {
        "reason": reason,
        "low": low,
        "high": high,
        "choices": choices,
        "unit": unit,
        "expert": expert,
    }
    return field(default=default, metadata=metadata)


_JSON_TYPES = {"int": "integer", "float": "number", "str": "string", "bool": "boolean"}


def _kind(declared: Field[Any]) -> tuple[str, bool]:
    """The field's plain type name and whether None is allowed."""
    words = str(declared.type).split(" | ")
    return words[0], "None" in words


def schema_of(declared: Field[Any], group: str | None) -> dict[str, Any]:
    """JSON Schema of one option; `group` is the room that reads it, None for the job itself."""
    kind, optional = _kind(declared)
    about = declared.metadata
    json_type = _JSON_TYPES[kind]
    schema: dict[str, Any] = {
        "type": [json_type, "null"] if optional else json_type,
        "description": about["reason"],
        "default": declared.default,
    }
    if about["low"] is not None:
        schema["minimum"] = about["low"]
    if about["high"] is not None:
        schema["maximum"] = about["high"]
    if about["choices"] is not None:
        schema["enum"] = list(about["choices"])
    if about["unit"] is not None:
        schema["x-unit"] = about["unit"]
    schema["x-group"] = group or "job"
    schema["x-expert"] = about["expert"]
    return schema


def checked(declared: Field[Any], value: Any) -> Any:
    """`value` as the option holds it; raises OptionsError for a wrong type or one out of range."""
    kind, optional = _kind(declared)
    name, about = declared.name, declared.metadata
    if value is None and optional:
        return None
    if kind == "float" and isinstance(value, int) and not isinstance(value, bool):
        # A whole number too large for a float is as far out of range as infinity.
        value = float(value) if abs(value) < 2**1023 else math.inf
    expected = {"int": int, "float": float, "str": str, "bool": bool}[kind]
    if not isinstance(value, expected) or (kind == "int" and isinstance(value, bool)):
        raise OptionsError(
            f"{name} is {value!r}", where=name, advice=f"It takes a value of type {kind}."
        )
    if isinstance(value, float) and not math.isfinite(value):
        raise OptionsError(f"{name} is {value}", where=name, advice="It takes a finite number.")
    low, high, choices = about["low"], about["high"], about["choices"]
    if choices is not None and value not in choices:
        raise OptionsError(
            f"{name} is {value!r}", where=name, advice=f"Use one of {', '.join(choices)}."
        )
    if (low is not None and value < low) or (high is not None and value > high):
        bounds = f"at least {low:g}" if high is None else f"between {low or 0:g} and {high:g}"
        raise OptionsError(f"{name} is {value}", where=name, advice=f"It must be {bounds}.")
    return value
