"""What holds for every test: a GLB that it writes is one that Khronos' validator finds sound.

And a busy machine is no fault: Hypothesis' own bounds measure the time of the clock on the wall.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from mpf_core.surface import export
from mpf_core.surface.mesh import Mesh
from tests import gltf

# One cache of compiled loops for all: with one in each test's data folder every worker that a test
# starts would compile anew.
LOOPS = Path(__file__).resolve().parent.parent / ".pytest_cache" / "loops"
os.environ.setdefault("NUMBA_CACHE_DIR", str(LOOPS))

settings.register_profile(
    "busy machine", deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("busy machine")


@pytest.fixture(autouse=True)
def _every_glb_is_valid(
    monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[None]:
    """Keeps a copy of each GLB made in this process and has them judged when the test ends.

    Those made in job processes are fetched and judged by the tests that start them. Without the
    validator nothing is judged here; test_export.py fails then.
    """
    made: list[bytes] = []
    original = export.glb_bytes

    def kept(mesh: Mesh, *, name: str = "surface") -> bytes:
        made.append(original(mesh, name=name))
        return made[-1]

    monkeypatch.setattr(export, "glb_bytes", kept)
    yield
    if made and gltf.is_installed():
        folder = tmp_path_factory.mktemp("glb")
        paths = [folder / f"{number}.glb" for number in range(len(made))]
        for path, content in zip(paths, made, strict=True):
            path.write_bytes(content)
        gltf.assert_valid(*paths)
