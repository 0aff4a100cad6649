"""API keys, share links and rates in Redis; of a secret only its hash is kept."""

from __future__ import annotations

import hashlib
import hmac
import secrets
from dataclasses import dataclass
from typing import Any

from redis import Redis

_KEYS = "mpf:keys"
_TOKEN_PREFIX = "mpf"  # noqa: S105  not a secret

# Generic cell rate: one number per caller, the time at which its bucket is empty again.
# KEYS[1] number; ARGV: ms per request, ms of burst. Answers the ms to wait, or 0.
_TAKE = """
local t = redis.call('TIME')
local now = t[1] * 1000 + math.floor(t[2] / 1000)
local step, burst = tonumber(ARGV[1]), tonumber(ARGV[2])
local empty = tonumber(redis.call('GET', KEYS[1]) or now)
if empty < now or empty > now + burst + step then empty = now end
if empty + step - now > burst then return math.ceil(empty + step - burst - now) end
redis.call('SET', KEYS[1], string.format('%d', empty + step),
           'PX', string.format('%d', burst + step))
return 0
"""


@dataclass(frozen=True)
class ApiKey:
    """What is known of a key. Its secret was shown once, when it was made."""

    id: str
    name: str
    created_at: float
    revoked: bool


class KeyStore:
    """Keys are random and long, so one round of SHA-256 is all the hashing they need."""

    def __init__(self, redis: Redis):
        self._redis = redis

    def create(self, name: str) -> tuple[ApiKey, str]:
        """A new key and the token to give to its user."""
        key = ApiKey(secrets.token_hex(6), name, float(self._redis.time()[0]), False)
        secret = secrets.token_urlsafe(32)
        with self._redis.pipeline(transaction=True) as pipeline:
            pipeline.hset(
                _key(key.id),
                mapping={"name": name, "created_at": key.created_at, "digest": _digest(secret)},
            )
            pipeline.sadd(_KEYS, key.id)
            pipeline.execute()
        return key, f"{_TOKEN_PREFIX}_{key.id}_{secret}"

    def all(self) -> list[ApiKey]:
        """Every key there is or was, oldest first."""
        ids = [_text(key_id) for key_id in self._redis.smembers(_KEYS)]
        found = [self._read(key_id)[0] for key_id in ids]
        return sorted((key for key in found if key), key=lambda key: key.created_at)

    def any_valid(self) -> bool:
        """Whether anybody could pass."""
        return any(not key.revoked for key in self.all())

    def revoke(self, key_id: str) -> bool:
        """End a key; its jobs stay. Says whether there was such a key."""
        if not self._redis.sismember(_KEYS, key_id):
            return False
        self._redis.hset(_key(key_id), "revoked", "1")
        return True

    def find(self, token: str) -> ApiKey | None:
        """The valid key that `token` belongs to."""
        prefix, _, rest = token.partition("_")
        key_id, _, secret = rest.partition("_")
        if prefix != _TOKEN_PREFIX or not secret or not key_id.isalnum():
            return None
        key, digest = self._read(key_id)
        if key is None or key.revoked or not hmac.compare_digest(digest, _digest(secret)):
            return None
        return key

    def _read(self, key_id: str) -> tuple[ApiKey | None, str]:
        record: Any = self._redis.hgetall(_key(key_id))
        if not record:
            return None, ""
        fields = {_text(name): _text(value) for name, value in record.items()}
        created_at = float(fields["created_at"])
        return ApiKey(key_id, fields["name"], created_at, "revoked" in fields), fields["digest"]


class RateLimit:
    """So many requests a minute per caller, over all replicas."""

    def __init__(self, redis: Redis, per_minute: int, burst: int):
        self._take = redis.register_script(_TAKE)
        self._step = 60_000 / per_minute if per_minute else 0.0
        self._burst = self._step * burst

    def seconds_to_wait(self, caller: str) -> float:
        """0 if one more request of this caller is fine."""
        if not self._step:
            return 0.0
        name = hashlib.sha256(caller.encode()).hexdigest()[:32]
        return float(self._take(keys=[f"mpf:rate:{name}"], args=[self._step, self._burst])) / 1000


@dataclass(frozen=True)
class Share:
    """A link with which anybody may read one job."""

    id: str
    job_id: str
    expires_at: float


class ShareStore:
    """Shares lapse by themselves; revoking one is forgetting it."""

    def __init__(self, redis: Redis):
        self._redis = redis

    def create(self, job_id: str, seconds: int) -> tuple[Share, str]:
        """A new share and its token."""
        token = secrets.token_urlsafe(32)
        share = Share(_digest(token)[:16], job_id, float(self._redis.time()[0]) + seconds)
        fields: dict[Any, Any] = {
            "job": job_id,
            "digest": _digest(token),
            "expires_at": share.expires_at,
        }
        with self._redis.pipeline(transaction=True) as pipeline:
            pipeline.hset(_share(share.id), mapping=fields)
            pipeline.expire(_share(share.id), seconds)
            pipeline.execute()
        return share, token

    def find(self, token: str) -> str | None:
        """The id of the job that `token` lets read."""
        share_id = _digest(token)[:16]
        job_id, digest = self._redis.hmget(_share(share_id), ["job", "digest"])
        if job_id is None or not hmac.compare_digest(_text(digest or b""), _digest(token)):
            return None
        return _text(job_id)

    def revoke(self, job_id: str, share_id: str) -> bool:
        """End a share of this job. Says whether there was one."""
        found = self._redis.hget(_share(share_id), "job")
        if found is None or _text(found) != job_id:
            return False
        return bool(self._redis.delete(_share(share_id)))


def _key(key_id: str) -> str:
    return f"mpf:key:{key_id}"


def _share(share_id: str) -> str:
    return f"mpf:share:{share_id}"


def _digest(secret: str) -> str:
    return hashlib.sha256(secret.encode()).hexdigest()


def _text(value: bytes | str) -> str:
    return value.decode() if isinstance(value, bytes) else value
