"""What a caller may choose, written once: the HTTP schema and the command's flags derive from it.

`Options` is a value. A preset is such a value with a name, nothing else; `options_from` starts at
a preset and replaces what a caller names. Callers see one flat namespace of fields; the groups
(`fit`, `surface`, `data`, `tile`) only say which room reads them. Lengths are normalised
([-1, 1]³).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import MISSING, Field, dataclass, field, fields, is_dataclass, replace
from typing import Any

from mpf_core.errors import OptionsError
from mpf_core.fit_options import FitOptions
from mpf_core.option_fields import checked, option, schema_of

PRESET_NAMES = ("draft", "balanced", "paper")

LOWEST_RESOLUTION = 96  # cells, of what is chosen


@dataclass(frozen=True)
class SurfaceOptions:
    """How the mesh is taken from the field."""

    resolution: int | None = option(
        None,
        "Grid cells along the longest side of the box; chosen from the spacing if not given.",
        low=16,
        high=2048,
        unit="cells",
        expert=False,
    )
    highest_resolution: int = option(
        512,
        "As many cells at most that are chosen, more of a scene in tiles; thin walls may have "
        "more. A draft has time for half as many crossed cells.",
        low=LOWEST_RESOLUTION,
        high=1024,
        unit="cells",
    )
    coarsen_to: int = option(
        500_000,
        "About as many faces at most that coarsening leaves, more of a scene in tiles: for so many "
        "a preset and the last step have time.",
        low=20_000,
        high=500_000,
        unit="faces",
    )
    coarsen: str = option(
        "auto",
        "Merge triangles finer than the samples can describe, where the grid had to be that fine "
        "for thin walls; a resolution that was asked for is left as it is.",
        choices=("auto", "off"),
    )
    surface_kind: str = option(
        "shell",
        "Closed everywhere, with open sheets wrapped in a thin shell; or one layer of triangles "
        "on sheets, with a boundary where the data end. Solids stay closed in both.",
        choices=("shell", "sheet"),
        expert=False,
    )
    min_component: int = option(
        16,
        "Components that fewer samples than this are nearest to are removed; 16 samples are what "
        "one normal is estimated from. The largest component always stays.",
        low=0,
        high=1_000_000,
        unit="samples",
        expert=False,
    )
    max_faces: int | None = option(
        None,
        "Reduce the mesh to at most about so many faces; the report says how far it moved.",
        low=100,
        high=100_000_000,
        unit="faces",
        expert=False,
    )
    smoothing: int = option(
        0,
        "Rounds of Taubin's filter, which evens the mesh without shrinking it. Off: the field is "
        "smooth already, and edges would suffer.",
        low=0,
        high=1000,
        unit="rounds",
    )
    slices: int = option(
        32, "φ-slice images per axis, evenly spaced over the shape.", low=0, high=64, expert=False
    )


@dataclass(frozen=True)
class DataOptions:
    """How the mesh follows the data once it is taken from the field. This needs the samples: a mesh
    taken from a stored field is the network's own."""

    fidelity: str = option(
        "auto",
        "The last step: vertices move onto the locally fitted data as far as the noise allows; off "
        "leaves the mesh as the network alone has it.",
        choices=("auto", "off"),
        expert=False,
    )
    sheet_thickness: float = option(
        0.03,
        "Thickness that the last step gives to the shell around an open sheet: a one-layer surface "
        "is then missed by a quarter of it on average, and the walls still stay well apart.",
        low=0.01,
        high=1.0,
        unit="median distance to the sixth neighbour",
    )


MOST_TILES = 256
"""Of one cloud, and of a blended field that is read."""


@dataclass(frozen=True)
class TileOptions:
    """When a cloud is fitted in parts."""

    tiles: str = option(
        "auto",
        "Fit clouds of more than tile_points samples in overlapping tiles, and blend their fields: "
        "finer detail, and longer in proportion. Needs the warm start.",
        choices=("auto", "off"),
        expert=False,
    )
    tile_points: int = option(
        400_000,
        "Samples of a tile. A fit analyses at most 200 000 of those that it is given, and its "
        "network cannot hold more: two in one voxel are no loss, three would be. A draft, which "
        "analyses half as many, shows less.",
        low=100,
        high=10_000_000,
        unit="samples",
    )


@dataclass(frozen=True)
class Options:
    """All choices of one reconstruction."""

    preset: str = option(
        "balanced", "The value these options started from.", choices=PRESET_NAMES, expert=False
    )
    seed: int = option(0, "Seed of every random draw.", low=0, high=2**31 - 1, expert=False)
    threads: int | None = option(
        None,
        "CPU threads; all that the process may use if not given.",
        low=1,
        high=256,
        expert=False,
    )
    fit: FitOptions = field(default_factory=FitOptions)
    surface: SurfaceOptions = field(default_factory=SurfaceOptions)
    data: DataOptions = field(default_factory=DataOptions)
    tile: TileOptions = field(default_factory=TileOptions)


PRESETS: dict[str, Options] = {
    "balanced": Options(),
    # Half the points of a step in half the width: five times the iterations, which thin shells need
    # more. Samples looked at and faces left are as few as leave a slow machine a third of the
    # minute for a room's fit.
    "draft": Options(
        preset="draft",
        fit=FitOptions(
            max_iterations=1600,
            time_budget=55.0,
            analysed=50_000,
            width=128,
            surface_points=768,
            near_points=256,
            far_points=512,
            laplacian_points=64,
            start_points=2048,
        ),
        surface=SurfaceOptions(highest_resolution=384, coarsen_to=150_000),
    ),
    # The recipe of the paper and of the published code of its relatives, with no additions.
    "paper": Options(
        preset="paper",
        fit=FitOptions(
            max_iterations=10_000,
            time_budget=7 * 86_400.0,
            denoise="off",
            precision="float32",
            warm_start=False,
            warm_fraction=0.0,
            omega=30.0,
            slow_waves=0.0,
            surface_points=15_000,
            near_points=15_000,
            far_points=15_000,
            laplacian_points=15_000,
            optimizer="adam",
            schedule="constant",
            patience=0.0,
            averaging=0.0,
            learning_rate=5e-5,
            gradient_clip=1.4e-3,
            align_at_folds=True,
            weight_phase=0.002,
            weight_normal=0.15,
            rim_normals=1.0,
            rim_draws=1.0,
        ),
        surface=SurfaceOptions(resolution=256),
        data=DataOptions(fidelity="off"),
    ),
}


def option_fields() -> Iterator[tuple[str | None, Field[Any]]]:
    """Every option that a caller may name, as (group or None, dataclass field)."""
    for top in fields(Options):
        if top.default is MISSING:
            for inner in fields(top.default_factory):  # type: ignore[arg-type]
                yield top.name, inner
        else:
            yield None, top


def options_from(changes: Mapping[str, Any]) -> Options:
    """The preset named in `changes` (or `balanced`) with the other named fields replaced.

    Raises OptionsError for an unknown name, a wrong type or a value out of range.
    """
    name = changes.get("preset", "balanced")
    if not isinstance(name, str) or name not in PRESETS:
        raise OptionsError(
            f"preset is {name!r}", where="preset", advice=f"Use one of {', '.join(PRESETS)}."
        )
    known = {f.name: (group, f) for group, f in option_fields()}
    grouped: dict[str | None, dict[str, Any]] = {}
    for key, value in changes.items():
        if key not in known:
            raise OptionsError(
                f"there is no option {key!r}", where=key, advice="See the list of options."
            )
        group, declared = known[key]
        grouped.setdefault(group, {})[key] = checked(declared, value)
    base = PRESETS[name]
    for group, values in grouped.items():
        if group is None:
            base = replace(base, **values)
        else:
            base = replace(base, **{group: replace(getattr(base, group), **values)})
    return base


def options_to_mapping(options: Options) -> dict[str, Any]:
    """The flat form that `options_from` reads; JSON-serialisable."""
    flat: dict[str, Any] = {}
    for top in fields(options):
        value = getattr(options, top.name)
        if is_dataclass(value):
            flat.update({f.name: getattr(value, f.name) for f in fields(value)})
        else:
            flat[top.name] = value
    return flat


def options_schema() -> dict[str, Any]:
    """JSON Schema (2020-12) of what `options_from` accepts."""
    properties = {f.name: schema_of(f, group) for group, f in option_fields()}
    return {"type": "object", "properties": properties, "additionalProperties": False}
