"""In which precision the hidden products of a fit are taken."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch


def products_in(choice: str) -> torch.dtype:
    """The type for one of "auto", "float32", "bfloat16"; "auto" asks the processor what it has."""
    if choice == "bfloat16" or (choice == "auto" and gains(torch.cpu.get_capabilities())):
        return torch.bfloat16
    return torch.float32


def gains(processor: Mapping[str, Any]) -> bool:
    """Whether products in bfloat16 are faster there than in float32 (decision 9).

    With tiles (AMX) they are, and with AVX512-BF16 on AMD's. Intel's issue one such instruction in
    the time of two in float32, and products ran half as fast where a machine hides the tiles.
    Measuring both instead would let a busy moment decide, and with it the result.
    """
    if processor.get("amx_bf16") or processor.get("amx_tile"):
        return True
    intel = "intel" in str(processor.get("cpu_name", "")).lower()
    return bool(processor.get("avx512_bf16")) and not intel
