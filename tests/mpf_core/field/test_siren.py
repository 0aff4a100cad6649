"""How the network begins."""

from __future__ import annotations

import torch

from mpf_core.field.siren import SLOW, Siren


def begun(slow: float) -> Siren:
    return Siren(32, 40.0, torch.Generator().manual_seed(2), slow=slow)


def test_a_share_of_the_first_layer_begins_with_slow_waves() -> None:
    """And nothing else is changed by it."""
    plain, mixed = begun(0.0).state_dict(), begun(0.25).state_dict()
    first = plain.pop("input_weight"), mixed.pop("input_weight")
    assert torch.equal(first[1][:8], SLOW * first[0][:8])
    assert torch.equal(first[1][8:], first[0][8:])
    assert all(torch.equal(plain[name], mixed[name]) for name in plain)
