"""What a caller may choose when a mesh or slices are taken from a field that is fitted already.

One flat namespace, as with `mpf_core.options`: the options of the group `surface`, `threads`,
`mesh` and `cuts`. Torch-free: the HTTP service checks requests with it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

from mpf_core.errors import OptionsError
from mpf_core.options import Options, SurfaceOptions, options_from, options_schema

AXES = ("x", "y", "z")
FIELDS = ("phi", "r", "theta", "P")
MOST_PICTURES = 512  # of one extraction: some ten seconds' work

_SURFACE = tuple(f.name for f in fields(SurfaceOptions))
_DEFAULT = SurfaceOptions(slices=0)


@dataclass(frozen=True)
class Cuts:
    """Slices of `field` across `axis`: at positions in the input's units, or `count` evenly spaced.

    One of `at` and `count` says something; the other is empty or 0.
    """

    field: str
    axis: str
    at: tuple[float, ...] = ()
    count: int = 0

    @property
    def pictures(self) -> int:
        """How many."""
        return len(self.at) + self.count


@dataclass(frozen=True)
class ExtractionOptions:
    """All choices of one extraction. The stack of φ slices was made with the field: none here."""

    surface: SurfaceOptions = _DEFAULT
    threads: int | None = None
    mesh: bool = True
    cuts: tuple[Cuts, ...] = ()


def inherited(options: Mapping[str, Any]) -> dict[str, Any]:
    """What an extraction takes over from the options of the fit (or extraction) before it."""
    kept = {name: options[name] for name in _SURFACE if name in options}
    return kept | {"slices": 0}


def extraction_from(changes: Mapping[str, Any]) -> ExtractionOptions:
    """The defaults with the named options replaced.

    Raises OptionsError for an unknown name, a wrong type or a value out of range, or if nothing
    is asked for.
    """
    plain = {name: value for name, value in changes.items() if name not in ("mesh", "cuts")}
    for name in plain:
        if name not in (*_SURFACE, "threads"):
            raise OptionsError(
                f"{name!r} is no option of an extraction", where=name,
                advice="The field is fitted already; what shapes it is chosen with its job.",
            )  # fmt: skip
    checked: Options = options_from({"slices": 0} | plain)
    mesh = changes.get("mesh", True)
    if not isinstance(mesh, bool):
        raise OptionsError(f"mesh is {mesh!r}", where="mesh", advice="Use true or false.")
    cuts = _cuts(changes.get("cuts", []))
    if not mesh and not cuts and not checked.surface.slices:
        raise OptionsError("nothing is asked for", where="mesh", advice="Name cuts, or a mesh.")
    return ExtractionOptions(checked.surface, checked.threads, mesh, cuts)


def extraction_to_mapping(options: ExtractionOptions) -> dict[str, Any]:
    """The flat form that `extraction_from` reads; JSON-serialisable."""
    cuts = [{k: v for k, v in asdict(c).items() if v not in ((), 0)} for c in options.cuts]
    for told in cuts:
        told.update({"at": list(told["at"])} if "at" in told else {})
    own = {"threads": options.threads, "mesh": options.mesh, "cuts": cuts}
    return asdict(options.surface) | own


def extraction_schema() -> dict[str, Any]:
    """JSON Schema (2020-12) of what `extraction_from` accepts."""
    known = options_schema()["properties"]
    properties = {name: known[name] for name in (*_SURFACE, "threads")}
    properties["slices"] = known["slices"] | {"default": 0}
    properties["mesh"] = {
        "type": "boolean", "default": True, "description": "Extract the mesh; false: only slices.",
    }  # fmt: skip
    properties["cuts"] = {
        "type": "array",
        "default": [],
        "description": f"Slices, {MOST_PICTURES} at most in all; each cut names `at` or `count`.",
        "items": {
            "type": "object",
            "required": ["axis"],
            "additionalProperties": False,
            "properties": {
                "field": {"type": "string", "enum": list(FIELDS), "default": "phi"},
                "axis": {"type": "string", "enum": list(AXES)},
                "at": {
                    "type": "array", "items": {"type": "number"}, "minItems": 1,
                    "description": "Positions along the axis, in the input's units.",
                },
                "count": {
                    "type": "integer", "minimum": 1, "maximum": MOST_PICTURES,
                    "description": "So many, evenly spaced over the box.",
                },
            },
        },
    }  # fmt: skip
    return {"type": "object", "properties": properties, "additionalProperties": False}


def _cuts(given: Any) -> tuple[Cuts, ...]:
    if not isinstance(given, list) or not all(isinstance(one, dict) for one in given):
        raise OptionsError(
            "cuts is not a list of objects", where="cuts",
            advice='Write [{"axis": "z", "field": "phi", "at": [0.1]}].',
        )  # fmt: skip
    if len(given) > MOST_PICTURES:
        raise _too_many(len(given))
    cuts = tuple(_cut(one, f"cuts[{place}]") for place, one in enumerate(given))
    if (pictures := sum(one.pictures for one in cuts)) > MOST_PICTURES:
        raise _too_many(pictures)
    return cuts


def _cut(given: dict[str, Any], where: str) -> Cuts:
    if unknown := set(given) - {"field", "axis", "at", "count"}:
        raise OptionsError(
            f"there is no {min(unknown)!r} in a cut", where=where,
            advice="A cut has field, axis, and at or count.",
        )  # fmt: skip
    made = Cuts(
        _choice(given.get("field", "phi"), FIELDS, f"{where}.field"),
        _choice(given.get("axis"), AXES, f"{where}.axis"),
    )
    if ("at" in given) == ("count" in given):
        raise OptionsError(
            "a cut names either `at` or `count`", where=where, advice="Name one of the two."
        )
    if "count" in given:
        count = given["count"]
        if not isinstance(count, int) or isinstance(count, bool) or count < 1:
            raise OptionsError(
                f"count is {count!r}", where=f"{where}.count", advice="It is a whole number from 1."
            )
        return replace(made, count=count)
    at = given["at"]
    if not isinstance(at, list) or not at or not all(_is_place(value) for value in at):
        raise OptionsError(
            "at is not a list of numbers", where=f"{where}.at", advice="Write [0.1, 0.2]."
        )
    return replace(made, at=tuple(float(value) for value in at))


def _is_place(value: Any) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return abs(value) <= 1e101 and math.isfinite(value)


def _choice(value: Any, choices: tuple[str, ...], where: str) -> str:
    if not isinstance(value, str) or value not in choices:
        raise OptionsError(
            f"{where.rpartition('.')[2]} is {value!r}",
            where=where,
            advice=f"Use one of {', '.join(choices)}.",
        )
    return value


def _too_many(count: int) -> OptionsError:
    return OptionsError(
        f"{count} slices are asked for", where="cuts",
        advice=f"One extraction draws {MOST_PICTURES} at most.",
    )  # fmt: skip
