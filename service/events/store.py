"""Names of the streams of events; `jobs/store.py` writes to them within its own atomic changes."""

from __future__ import annotations

# Wakes everyone who waits for a change of any job; carries the job's id.
FEED_CHANNEL = "mpf:feed"

# Events kept per job; older ones are dropped, the record always has the latest state.
EVENTS_KEPT = 1000


def stream_key(job_id: str) -> str:
    """The stream that holds a job's events."""
    return f"mpf:job:{job_id}:events"
