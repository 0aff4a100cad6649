"""The names that tools give to columns, and what they mean.

A role is one of x y z, nx ny nz, red green blue, f_dc_0 f_dc_1 f_dc_2, alpha, intensity, opacity.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

COORDINATES = ("x", "y", "z")
NORMALS = ("nx", "ny", "nz")
COLORS = ("red", "green", "blue")
SPLAT_COLORS = ("f_dc_0", "f_dc_1", "f_dc_2")

MEANINGS = {
    "nx": "normal x",
    "ny": "normal y",
    "nz": "normal z",
    "f_dc_0": "red (spherical harmonic)",
    "f_dc_1": "green (spherical harmonic)",
    "f_dc_2": "blue (spherical harmonic)",
}

_SURVEYED = {  # what surveyors call the axes
    "x": ("easting", "east"),
    "y": ("northing", "north"),
    "z": ("elevation", "height", "altitude"),
}

# Aliases of one role in order of preference: where a file has several, the first one counts.
_ALIASES: dict[str, tuple[str, ...]] = {
    "intensity": ("intensity", "i", "reflectance", "remission", "scalar_intensity"),
    "alpha": ("alpha", "a", "diffuse_alpha", "vertex_alpha"),
    "opacity": ("opacity",),
}
for _axis, _number in zip("xyz", "012", strict=True):
    _ALIASES[_axis] = (
        _axis,
        f"{_axis}_coord",
        f"{_axis}coord",
        f"coord_{_axis}",
        f"{_axis}_coordinate",
        f"{_axis}_pos",
        f"pos_{_axis}",
        f"position_{_axis}",
        f"position{_axis}",
        f"points_{_number}",
        *_SURVEYED[_axis],
    )
    _ALIASES[f"n{_axis}"] = (
        f"n{_axis}",
        f"n_{_axis}",
        f"{_axis}n",
        f"normal_{_axis}",
        f"normal{_axis}",
        f"{_axis}_normal",
        f"normals_{_axis}",
        f"vertex_normal_{_axis}",
        f"normals_{_number}",
        f"normal_{_number}",
    )
for _color, _number in zip(COLORS, "012", strict=True):
    _ALIASES[_color] = (
        _color,
        _color[0],
        f"diffuse_{_color}",
        f"color_{_color}",
        f"color_{_color[0]}",
        f"vertex_{_color}",
        f"{_color}_color",
        f"{_color}_value",
        f"{_color[0]}f",
        f"rgb_{_number}",
        f"rgba_{_number}",
        f"colors_{_number}",
        f"ambient_{_color}",
    )
for _splat in SPLAT_COLORS:
    _ALIASES[_splat] = (_splat,)

_ROLE_OF = {
    name: (role, rank) for role, names in _ALIASES.items() for rank, name in enumerate(names)
}


def roles_of(names: Sequence[str]) -> dict[str, int]:
    """Role → index into `names`; the best alias wins, and of equals the first."""
    best: dict[str, tuple[int, int]] = {}
    for index, name in enumerate(names):
        found = _ROLE_OF.get(plain_name(name))
        if found is None:
            continue
        role, rank = found
        if role not in best or rank < best[role][0]:
            best[role] = (rank, index)
    return {role: index for role, (_, index) in best.items()}


def plain_name(name: str) -> str:
    """A column's name without case, quotes, units and the marks that some tools put around it."""
    name = re.sub(r"[\"'`]", "", name.strip().lower())
    name = re.sub(r"\s*[(\[](m|mm|cm|km|ft|in|meters?|metres?)[)\]]$", "", name)
    name = name.lstrip("/#% ")
    return re.sub(r"[\s:.\-\[\]]+", "_", name).strip("_")


def meaning_of(role: str) -> str:
    """The role in words."""
    return MEANINGS.get(role, role)
