"""What a run in tiles keeps in a folder beside its checkpoint, for the next one to go on from.

FILE.tiles/run-{digest}/    plan, tiles and, by its number, the folder of each fitted tile
"""

from __future__ import annotations

import hashlib
import json
import re
import shutil
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path

from mpf_core.errors import FieldError, TileError
from mpf_core.field.artefact import load_field
from mpf_core.options import Options, options_to_mapping
from mpf_core.tiles.child import FIELD, REPORT
from mpf_core.tiles.patchfile import PATCHES, read_patches

RUN = re.compile(r"run-[0-9a-f]{24}")


def kept_beside(checkpoint: Path, cloud_path: Path, options: Options) -> Path:
    """The folder of this run, with what was kept of it or empty; those of others are removed.

    Named by cloud and options, it is never another run's.
    """
    folder = _base(checkpoint) / _name(cloud_path, options)
    if not folder.is_dir():
        forget_kept(checkpoint)
        folder.mkdir(parents=True)
    return folder


def forget_kept(checkpoint: Path) -> None:
    """Remove what runs in tiles have kept beside `checkpoint`, and nothing that is not theirs."""
    base = _base(checkpoint)
    if not base.is_dir():
        return
    for path in base.iterdir():
        if RUN.fullmatch(path.name):
            shutil.rmtree(path, ignore_errors=True)
    with suppress(OSError):  # there is something else in it
        base.rmdir()


def is_fitted(out: Path, options: Options, *, anyhow: bool) -> bool:
    """Whether the tile of the folder `out` is fitted: to its end, or `anyhow`.

    One whose files cannot be read is not, so that a damaged file costs one fit and no more.
    """
    try:
        told = json.loads((out / REPORT).read_bytes())
        hurried = told["options"]["max_iterations"] < options.fit.max_iterations
        if not anyhow and (hurried or told["fit"]["stopped_by"] == "cancel"):
            return False
        load_field(out / FIELD)
        if options.data.fidelity != "off":
            read_patches(out / PATCHES)
    except (FileNotFoundError, ValueError, KeyError, TypeError, FieldError, TileError):
        return False
    return True


def _base(checkpoint: Path) -> Path:
    return checkpoint.with_name(f"{checkpoint.name}.tiles")


def _name(cloud_path: Path, options: Options) -> str:
    """By a digest of all that plan and fields depend on; budgets say when a fit ends, not how it
    goes."""
    settings = options_to_mapping(options)
    settings.pop("time_budget")
    settings["version"] = version("metric-phase-fields")
    digest = hashlib.sha256(json.dumps(settings, sort_keys=True).encode())
    with cloud_path.open("rb") as file:
        while block := file.read(2**20):
            digest.update(block)
    return f"run-{digest.hexdigest()[:24]}"
