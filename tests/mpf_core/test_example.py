"""The example in the documentation, with nothing made smaller."""

from __future__ import annotations

import doctest

from mpf_core import pipeline


def test_the_example_of_the_pipeline_comes_out_as_it_says() -> None:
    assert doctest.testmod(pipeline) == doctest.TestResults(failed=0, attempted=9)
