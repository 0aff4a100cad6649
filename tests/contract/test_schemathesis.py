"""Whatever is sent, alone or one after the other, is answered as the OpenAPI document says.

schemathesis makes the requests up: bounds of every parameter, random ones, and sequences along the
document's links. `MPF_TEST_SEED=7 MPF_TEST_EXAMPLES=200` looks elsewhere, and for longer.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from pathlib import Path

import httpx2
import pytest

from service.access.store import KeyStore
from service.connection import connect
from tests.services import (
    REPOSITORY,
    Server,
    running_api,
    running_worker,
    settings_for,
    tell,
)

pytestmark = pytest.mark.slow

CHECKS = (
    "not_a_server_error", "status_code_conformance", "content_type_conformance",
    "response_headers_conformance", "response_schema_conformance", "use_after_free",
    "unsupported_method", "allow_header_conformance", "ignored_auth",
)  # fmt: skip
SEED = os.environ.get("MPF_TEST_SEED", "5")
EXAMPLES = int(os.environ.get("MPF_TEST_EXAMPLES", "20"))
TIMEOUT = 30  # s; a request that hangs is a failure

# Every bound of every option, in each of three kinds of body, would be two thousand requests more.
CONFIGURATION = f"""
[phases.stateful]
max-steps = 6
generation.max-examples = {EXAMPLES}

[[operations]]
include-operation-id = ["submit", "retry", "extraction"]
phases.coverage.enabled = false
phases.fuzzing.generation.max-examples = {EXAMPLES}
"""


def test_made_up_requests_are_answered_as_documented(shared_server: Server, tmp_path: Path) -> None:
    told = settings_for(
        shared_server, tmp_path, content_check_bytes=0, inspect_seconds=5.0, require_keys=True
    )
    redis = connect(told)
    redis.flushall()
    _, token = KeyStore(redis).create("schemathesis")
    redis.close()
    begin = time.monotonic()
    with running_api(told) as url, running_worker(told):
        # It is made when first asked for, which may take longer than schemathesis waits.
        assert httpx2.get(f"{url}/openapi.json", timeout=4 * TIMEOUT).status_code == 200
        found = made_up_requests(url, token, tmp_path)
        headers = {"Authorization": f"Bearer {token}"}
        jobs = httpx2.get(f"{url}/jobs?limit=200", headers=headers, timeout=TIMEOUT).json()["jobs"]
    assert found.returncode == 0, found.stdout + found.stderr
    links = re.search(r"API Links: +(\d+) covered", found.stdout)
    cases = re.search(r"(\d+) generated, (\d+) passed", found.stdout)
    assert links
    assert cases
    tell(
        f"{cases[2]} requests passed, {links[1]} kinds of link followed, {len(jobs)} jobs made, "
        f"{time.monotonic() - begin:.0f} s"
    )
    # It got past the door, and beyond the first room.
    assert int(links[1]) >= 10
    assert {"succeeded", "failed"} <= {job["state"] for job in jobs}


def made_up_requests(url: str, token: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """What `schemathesis run` says of the service at `url`."""
    configuration = folder / "schemathesis.toml"
    configuration.write_text(CONFIGURATION)
    command = [
        sys.executable, "-m", "schemathesis.cli", "--config-file", str(configuration), "run",
        f"{url}/openapi.json", "--header", f"Authorization: Bearer {token}",
        "--checks", ",".join(CHECKS), "--phases", "coverage,fuzzing,stateful",
        "--seed", SEED, "--max-examples", str(max(1, EXAMPLES // 5)), "--continue-on-failure",
        "--no-shrink", "--generation-database", "none", "--suppress-health-check", "all",
        "--request-timeout", str(TIMEOUT), "--request-retries", "0",
        "--warnings", "off", "--no-color",
    ]  # fmt: skip
    more = {
        "SCHEMATHESIS_HOOKS": "tests.contract.schemathesis_hooks",
        "MPF_TEST_TOKEN": token,
        "PYTHONPATH": str(REPOSITORY),
        "COLUMNS": "100",
    }
    return subprocess.run(
        command, env=os.environ | more, cwd=folder, capture_output=True, text=True, timeout=3600
    )
