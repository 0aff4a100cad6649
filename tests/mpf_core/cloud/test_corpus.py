"""The seeds and findings of the fuzz runs, replayed."""

from __future__ import annotations

from pathlib import Path

import pytest

from .test_mutations import survive

CORPUS = Path(__file__).parents[2] / "fuzz" / "corpus"


@pytest.mark.parametrize("path", sorted(CORPUS.iterdir()), ids=lambda path: path.name)
def test_corpus(path: Path) -> None:
    survive(path.read_bytes())
