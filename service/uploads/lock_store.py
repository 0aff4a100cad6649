"""Who writes to an upload in pieces, where no lock of a file system can say so."""

from __future__ import annotations

import secrets
from typing import Any

from redis import Redis

LOCK_SECONDS = 45
"""Longer than a sender may say nothing; a writer that died is waited for this long."""

# KEYS[1] lock; ARGV: token, ms (0: let go). Only its holder may change it.
_HOLD = """
if redis.call('GET', KEYS[1]) ~= ARGV[1] then return 0 end
if ARGV[2] == '0' then redis.call('DEL', KEYS[1]) else redis.call('PEXPIRE', KEYS[1], ARGV[2]) end
return 1
"""


class UploadLocks:
    """One writer per upload, over all replicas of the API."""

    def __init__(self, redis: Redis):
        self._redis = redis
        self._hold = redis.register_script(_HOLD)

    def take(self, upload_id: str) -> str | None:
        """A token, or None while another one writes."""
        token = secrets.token_hex(8)
        taken: Any = self._redis.set(_key(upload_id), token, nx=True, ex=LOCK_SECONDS)
        return token if taken else None

    def renew(self, upload_id: str, token: str) -> bool:
        """Whether the lock is still ours; it is for LOCK_SECONDS more."""
        return bool(self._hold(keys=[_key(upload_id)], args=[token, LOCK_SECONDS * 1000]))

    def free(self, upload_id: str, token: str) -> None:
        """Let others write."""
        self._hold(keys=[_key(upload_id)], args=[token, 0])


def _key(upload_id: str) -> str:
    return f"mpf:upload:{upload_id}:lock"
