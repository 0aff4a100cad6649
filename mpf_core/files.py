"""Files that appear whole or not at all."""

from __future__ import annotations

import uuid
from pathlib import Path


def write_atomically(path: str | Path, content: bytes) -> None:
    """Write `content` beside `path`, then rename: a reader sees the old file or the new one."""
    path = Path(path)
    beside = path.with_name(f".{path.name}.{uuid.uuid4().hex}.part")
    try:
        with beside.open("xb") as file:
            file.write(content)
        beside.replace(path)
    except BaseException:
        beside.unlink(missing_ok=True)
        raise
