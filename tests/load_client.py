"""The clients of `tests/load.py`, in processes of their own so that none waits for another:

    python -m tests.load_client poll HOST:PORT SECONDS CLIENTS JOB...
    python -m tests.load_client upload HOST:PORT SECONDS CLIENTS

Each prints one JSON object: seconds of every request, the answers that were no success, and the
processor time of this process.
"""

from __future__ import annotations

import asyncio
import json
import sys
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field

from tests.services import sphere_xyz

POLL_EVERY = 2.0  # s; what Retry-After says
UPLOAD_EVERY = 1.0  # s
TIMEOUT = 30.0
POINTS = 20_000

Exchange = Callable[[bytes], Awaitable[int]]


@dataclass
class Found:
    """times: of each request, s; errors: statuses other than 200 and 202, and broken connections"""

    times: list[float] = field(default_factory=list)
    errors: list[str] = field(default_factory=list)


class Connection:
    """Bare HTTP/1.1 that stays open: a client whose own cost is not measured."""

    def __init__(self, host: str, port: int):
        self._where = (host, port)
        self._streams: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None

    async def exchange(self, request: bytes) -> int:
        """Send, read the whole answer, tell its status."""
        if self._streams is None:
            self._streams = await asyncio.open_connection(*self._where)
        reader, writer = self._streams
        writer.write(request)
        head = (await reader.readuntil(b"\r\n\r\n")).lower()
        length = int(head.partition(b"content-length: ")[2].partition(b"\r\n")[0])
        await reader.readexactly(length)
        return int(head.split(maxsplit=2)[1])


async def press(
    where: str, seconds: float, clients: int, every: float, requests: list[bytes]
) -> Found:
    """So many clients, each with a connection and a request of its own, spread over `every`."""
    host, _, port = where.partition(":")
    found = Found()
    over = time.monotonic() + seconds

    async def one(number: int) -> None:
        await asyncio.sleep(every * number / clients)
        connection = Connection(host, int(port))
        request = requests[number % len(requests)]
        while time.monotonic() < over:
            start = time.perf_counter()
            try:
                async with asyncio.timeout(TIMEOUT):
                    status = await connection.exchange(request)
            except (OSError, EOFError, TimeoutError) as error:
                found.errors.append(repr(error))
                connection = Connection(host, int(port))
                continue
            found.times.append(time.perf_counter() - start)
            if status not in (200, 202):
                found.errors.append(str(status))
            await asyncio.sleep(every)

    async with asyncio.TaskGroup() as group:
        for number in range(clients):
            group.create_task(one(number))
    return found


def poll_of(job_id: str) -> bytes:
    return f"GET /jobs/{job_id} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode()


def upload() -> bytes:
    """A form with a cloud of half a megabyte."""
    body = (
        b'--b\r\nContent-Disposition: form-data; name="file"; filename="ok.xyz"\r\n\r\n'
        + sphere_xyz(POINTS)
        + b"\r\n--b--\r\n"
    )
    head = (
        "POST /jobs HTTP/1.1\r\nHost: localhost\r\n"
        f"Content-Type: multipart/form-data; boundary=b\r\nContent-Length: {len(body)}\r\n\r\n"
    )
    return head.encode() + body


def main(act: str, where: str, seconds: str, clients: str, *jobs: str) -> None:
    """Press, then print what was found."""
    every, requests = (
        (POLL_EVERY, [poll_of(job) for job in jobs])
        if act == "poll"
        else (UPLOAD_EVERY, [upload()])
    )
    found = asyncio.run(press(where, float(seconds), int(clients), every, requests))
    told = {"times": found.times, "errors": found.errors, "processor": time.process_time()}
    sys.stdout.write(json.dumps(told))


if __name__ == "__main__":
    main(*sys.argv[1:])
