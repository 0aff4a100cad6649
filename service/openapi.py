"""Writes the OpenAPI document: `python -m service.openapi [FILE]`."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from service.app import create_app
from service.settings import Settings

DEFAULT_FILE = Path("openapi/openapi.json")


def document() -> str:
    """The document as it is committed."""
    app = create_app(Settings())
    return json.dumps(app.openapi(), indent=2, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    target = Path(sys.argv[1]) if len(sys.argv) > 1 else DEFAULT_FILE
    target.write_text(document(), encoding="utf-8")
