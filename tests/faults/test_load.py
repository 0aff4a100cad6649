"""200 clients poll and 20 upload while two jobs use both cores: every one of them is answered.

How quickly is not a matter for a test that shares its machine: `python -m tests.load` measures it.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.load import measure
from tests.services import Server, tell

pytestmark = pytest.mark.slow

POLLERS, UPLOADERS = 200, 20


def test_everybody_is_answered_under_load(own_server: Server, tmp_path: Path) -> None:
    found = measure(own_server, tmp_path, seconds=15.0, pollers=POLLERS, uploaders=UPLOADERS)
    tell(str(found))
    assert not found.errors, found.errors[:3]
    assert len(found.times) >= POLLERS
    assert found.uploads >= UPLOADERS
