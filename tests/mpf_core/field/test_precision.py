import pytest
import torch

from mpf_core.field.precision import gains, products_in


@pytest.mark.parametrize(
    ("processor", "faster"),
    [
        ({"cpu_name": "AMD EPYC", "avx512_bf16": True, "amx_tile": False}, True),
        ({"cpu_name": "Intel Xeon", "avx512_bf16": True, "amx_tile": True}, True),
        ({"cpu_name": "Intel Xeon", "avx512_bf16": True, "amx_tile": False}, False),
        ({"cpu_name": "Intel Xeon", "avx512_bf16": False}, False),
        ({}, False),
    ],
)
def test_bfloat16_is_taken_where_its_products_are_faster(
    processor: dict[str, object], faster: bool
) -> None:
    assert gains(processor) is faster


def test_what_is_asked_for_is_taken_whatever_the_processor() -> None:
    assert products_in("float32") is torch.float32
    assert products_in("bfloat16") is torch.bfloat16


def test_this_processor_is_asked() -> None:
    here = torch.cpu.get_capabilities()
    assert "cpu_name" in here and "avx512_bf16" in here
    assert (products_in("auto") is torch.bfloat16) is gains(here)
