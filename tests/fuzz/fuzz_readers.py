"""Coverage-guided damage to files: every input ends in points or in a typed error.

    pip install atheris
    python tests/fuzz/fuzz_readers.py [CORPUS_DIR] -max_total_time=3600

Limits are those of the promise: 2 s of the processor and 512 MiB per input; libFuzzer's own clock
is the wall's and only ends what hangs. The seeds in tests/fuzz/corpus are used besides CORPUS_DIR,
to which new ones are written. Not collected by pytest; what a run finds becomes a seed in
tests/fuzz/corpus, which tests/mpf_core/cloud/test_corpus.py replays.
"""

from __future__ import annotations

import io
import sys
import time
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["mpf_core"]):
    from mpf_core.cloud.limits import HEADER_BYTES, Limits
    from mpf_core.cloud.prepare import prepare
    from mpf_core.cloud.reader import peek_header, read_stream
    from mpf_core.errors import InputError

CORPUS = Path(__file__).parent / "corpus"
SECONDS = 2.0


def one_input(data: bytes) -> None:
    """Reads and prepares; InputError is an answer, anything else is a finding."""
    start = time.process_time()
    try:
        peek_header(data[:HEADER_BYTES], len(data))
    except InputError as error:
        assert error.advice
    try:
        prepare(read_stream(io.BytesIO(data), len(data), limits=Limits()).cloud)
    except InputError as error:
        assert error.advice and "." in error.code
    assert time.process_time() - start < SECONDS


def main() -> None:
    """Hands over to libFuzzer."""
    given = sys.argv[1:]
    folders = [] if any(not a.startswith("-") for a in given) else ["out/fuzz"]
    Path("out/fuzz").mkdir(parents=True, exist_ok=True)
    words = Path(__file__).with_name("readers.dict")
    bounds = ["-timeout=120", "-rss_limit_mb=512", "-max_len=8192", f"-dict={words}"]
    atheris.Setup([sys.argv[0], *bounds, *given, *folders, str(CORPUS)], one_input)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
