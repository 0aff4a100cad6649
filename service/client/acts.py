"""The acts of a client: submitting with uploads that resume, following, fetching with a check."""

from __future__ import annotations

import base64
import hashlib
import time
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from service.client.steps import Ask, Pause, Steps, Unreachable, asked, problem_in
from service.jobs.schemas import JobListOut, JobOut

TUS = {"Tus-Resumable": "1.0.0"}
PIECE_TYPE = {"Content-Type": "application/offset+octet-stream"}

PIECE_BYTES = 4 * 2**20
"""Sent or fetched by one request: what an interruption costs at most."""

LOOK_SECONDS = 2.0
"""Between two looks at a job that is waited for; its state is told at once."""

Moved = Callable[[int, int], None]
"""Told of bytes that have arrived, of how many."""

Looked = Callable[[JobOut], None]
"""Told of a job as it stands."""


def silent(*_: object) -> None:
    """Tells nobody."""


class Acts:
    """patience: how long a service that is away is asked again, s."""

    def __init__(self, patience: float):
        self.patience = patience

    def ask(self, method: str, path: str, **more: Any) -> Steps[Any]:
        """One answer."""
        return (yield from asked(Ask(method, path, **more), self.patience))

    # Submitting

    def submit(
        self,
        cloud: Path,
        options: Mapping[str, Any] | None = None,
        *,
        label: str = "",
        upload: str | None = None,
        moved: Moved = silent,
        began: Callable[[str], None] = silent,
    ) -> Steps[JobOut]:
        """Send the cloud in pieces, then make a job of it; sent twice, it is one job.

        upload: one that was interrupted, as `began` was told of it, to go on with. Raises Refused,
        Unreachable, OSError.
        """
        with cloud.open("rb") as file:
            size = file.seek(0, 2)
            if upload is None:
                upload = yield from self._new_upload(cloud.name, size)
            began(upload)
            yield from self._send(file, size, upload, moved)
        body = {"upload": upload, "options": dict(options or {}), "label": label}
        headers = {"Idempotency-Key": uuid.uuid4().hex}
        answer = yield from self.ask("POST", "/jobs", json=body, headers=headers, timeout=180.0)
        return JobOut.model_validate(answer.json())

    def _new_upload(self, name: str, size: int) -> Steps[str]:
        told = base64.b64encode(name.encode()).decode()
        headers = TUS | {"Upload-Length": str(size), "Upload-Metadata": f"filename {told}"}
        answer = yield from self.ask("POST", "/uploads", headers=headers)
        return str(answer.headers["location"])

    def _send(self, file: IO[bytes], size: int, upload: str, moved: Moved) -> Steps[None]:
        offset = yield from self._offset(upload)
        deadline = time.monotonic() + self.patience
        while offset < size:
            moved(offset, size)
            file.seek(offset)
            headers = TUS | PIECE_TYPE | {"Upload-Offset": str(offset)}
            piece = file.read(PIECE_BYTES)
            try:
                # Once: whether a piece has come when no answer has is known by asking where to
                # go on.
                answer = yield Ask("PATCH", upload, headers=headers, content=piece, timeout=120.0)
                if answer.status_code == 204:
                    offset = int(answer.headers["upload-offset"])
                    deadline = time.monotonic() + self.patience
                    continue
                if answer.status_code not in (409, 423, 429, 502, 503, 504):
                    raise problem_in(answer)
            except Unreachable:
                if time.monotonic() > deadline:
                    raise
            else:
                if time.monotonic() > deadline:
                    raise problem_in(answer)
            yield Pause(0.5)
            offset = yield from self._offset(upload)
        moved(size, size)

    def _offset(self, upload: str) -> Steps[int]:
        answer = yield from self.ask("HEAD", upload, headers=TUS)
        return int(answer.headers["upload-offset"])

    # Looking

    def job(self, job_id: str, wait: float = 0.0) -> Steps[JobOut]:
        """The job as it stands, or as soon as its state is another."""
        params = {"wait": wait} if wait else {}
        answer = yield from self.ask(
            "GET", f"/jobs/{job_id}", params=params, timeout=wait + 30.0
        )  # fmt: skip
        return JobOut.model_validate(answer.json())

    def jobs(
        self, *, states: Sequence[str] = (), label: str | None = None, limit: int = 50
    ) -> Steps[list[JobOut]]:
        """One's jobs, newest first, `limit` at most."""
        params: dict[str, Any] = {"limit": min(limit, 200)}
        if states:
            params["state"] = list(states)
        if label is not None:
            params["label"] = label
        found: list[JobOut] = []
        while len(found) < limit:
            answer = yield from self.ask("GET", "/jobs", params=params)
            page = JobListOut.model_validate(answer.json())
            found += page.jobs
            if page.next is None:
                break
            params["cursor"] = page.next
        return found[:limit]

    def wait(self, job_id: str, looked: Looked = silent) -> Steps[JobOut]:
        """The job once it has ended; `looked` is told of it until then."""
        while True:
            job = yield from self.job(job_id, LOOK_SECONDS)
            looked(job)
            if job.state in ("succeeded", "failed", "cancelled"):
                return job

    # Changing

    def cancel(self, job_id: str, *, keep: bool = False) -> Steps[JobOut]:
        """Ask the job to stop; keep: have the surface so far as its result."""
        params = {"keep": "result"} if keep else {}
        answer = yield from self.ask("POST", f"/jobs/{job_id}/cancel", params=params)
        return JobOut.model_validate(answer.json())

    def delete(self, job_id: str) -> Steps[None]:
        """Remove the job and its files."""
        yield from self.ask("DELETE", f"/jobs/{job_id}", again=False)

    def retry(self, job_id: str, options: Mapping[str, Any] | None = None) -> Steps[JobOut]:
        """A new job on the same input, with some options changed."""
        return (yield from self._again(f"/jobs/{job_id}/retry", options))

    def extract(self, job_id: str, options: Mapping[str, Any] | None = None) -> Steps[JobOut]:
        """A new job that takes a mesh or slices from the field of this one."""
        return (yield from self._again(f"/jobs/{job_id}/extractions", options))

    def _again(self, path: str, options: Mapping[str, Any] | None) -> Steps[JobOut]:
        headers = {"Idempotency-Key": uuid.uuid4().hex}
        body = {"options": dict(options or {})}
        answer = yield from self.ask("POST", path, json=body, headers=headers)
        return JobOut.model_validate(answer.json())

    # Fetching

    def download(self, job: JobOut, name: str, path: Path, moved: Moved = silent) -> Steps[None]:
        """A file of the result, in pieces, checked against its SHA-256; whole at `path` or not.

        Raises Refused, Unreachable (also where the bytes are not those that were published),
        OSError, KeyError for a name that the result does not have.
        """
        about = job.artifacts[name]
        digest = hashlib.sha256()
        with _appearing(path) as file:
            done = 0
            while done < about.bytes:
                last = min(about.bytes, done + PIECE_BYTES) - 1
                headers = {"Range": f"bytes={done}-{last}"}
                answer = yield from self.ask("GET", about.href, headers=headers)
                piece = answer.content
                if "content-range" not in answer.headers:  # a proxy that knows no ranges
                    piece = piece[done:]
                if not piece:
                    break
                digest.update(piece)
                file.write(piece)
                done += len(piece)
                moved(done, about.bytes)
            if digest.hexdigest() != about.sha256:
                raise Unreachable(f"{about.href} came with other bytes than were published")


@contextmanager
def _appearing(path: Path) -> Iterator[IO[bytes]]:
    """A file that is at `path` once the block has ended well."""
    beside = path.with_name(f".{path.name}.{uuid.uuid4().hex}.part")
    try:
        with beside.open("xb") as file:
            yield file
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)
