"""The whole state of a fit as a value: to go back to when a fit diverges, and to go on from.

On disk a state is a safetensors file whose header carries the rest as JSON, written whole or not
at all. It names what it belongs to, so that it is never taken for another fit's.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from mpf_core.errors import CheckpointError
from mpf_core.files import write_atomically
from mpf_core.fit.sampler import Pools
from mpf_core.fit_options import FitOptions

FORMAT = "mpf-checkpoint-2"


@dataclass(frozen=True)
class State:
    """Everything that the next step depends on.

    tensors: of network, optimisers and random generator, copied; facts: JSON values, among them
    the iteration; history: reports so far, as mappings
    """

    tensors: dict[str, Tensor]
    facts: dict[str, Any]
    history: list[dict[str, Any]] = field(default_factory=list)


def fingerprint(pools: Pools, options: FitOptions, seed: int, threads: int) -> str:
    """Names a fit by all that its result depends on."""
    settings = {**asdict(options), "seed": seed, "threads": threads, "torch": torch.__version__}
    # The budget says when a fit ends, not how it goes; resumed fits have another.
    settings.pop("time_budget")
    digest = hashlib.sha256(json.dumps(settings, sort_keys=True).encode())
    parts = [pools.surface, pools.normals, pools.near.x[:10_000], pools.far.x[:10_000]]
    if pools.near.layered is not None:
        parts.append(pools.near.layered[:10_000])
    for part in parts:
        digest.update(part.numpy().tobytes())
    return digest.hexdigest()


def write_state(path: Path, state: State, belongs_to: str) -> None:
    """Keep a state on disk, in place of what was there."""
    facts = json.dumps({"facts": state.facts, "history": state.history})
    header = {"format": FORMAT, "fit": belongs_to, "state": facts}
    write_atomically(path, save(state.tensors, metadata=header))


def read_state(path: Path, belongs_to: str) -> State | None:
    """The state at `path`, or None where there is none.

    Raises CheckpointError for a damaged file and for one of another fit.
    """
    if not path.exists():
        return None
    try:
        with safe_open(path, framework="pt") as file:
            header = file.metadata() or {}
            if header.get("format") != FORMAT:
                raise CheckpointError("this is not a checkpoint of a fit", where=path.name)
            if header.get("fit") != belongs_to:
                raise CheckpointError("the checkpoint is of another fit", where=path.name)
            told = json.loads(header["state"])
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        return State(tensors, dict(told["facts"]), list(told["history"]))
    except (SafetensorError, ValueError, KeyError, TypeError, OSError) as error:
        raise CheckpointError(f"the checkpoint cannot be read: {error}", where=path.name) from error
