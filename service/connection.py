"""One way to reach Redis, with time-outs on everything."""

from __future__ import annotations

from redis import Redis
from redis.backoff import ExponentialBackoff
from redis.exceptions import ConnectionError as RedisConnectionError
from redis.exceptions import RedisError, ResponseError
from redis.exceptions import TimeoutError as RedisTimeoutError
from redis.retry import Retry

from service.settings import Settings

# What a caller meets while Redis is away, restarting or loading its file.
UNREACHABLE = (RedisConnectionError, RedisTimeoutError)


class UnsafeRedis(Exception):
    """This Redis would lose jobs; str() says which setting and what to do."""


def connect(settings: Settings) -> Redis:
    """A client whose every call ends: 2 s to connect, 5 s per command, two quick retries."""
    return Redis.from_url(
        settings.redis_url,
        socket_connect_timeout=2.0,
        socket_timeout=5.0,
        health_check_interval=15,
        retry=Retry(ExponentialBackoff(cap=0.2, base=0.02), retries=2),
        retry_on_error=list(UNREACHABLE),
    )


def require_noeviction(redis: Redis) -> None:
    """Refuse a Redis that drops records when its memory is full."""
    try:
        policy = redis.config_get("maxmemory-policy").get("maxmemory-policy")
    except ResponseError:
        return  # managed offerings forbid CONFIG; docs/operations.md says what to set there
    name = policy.decode() if isinstance(policy, bytes) else policy
    if name != "noeviction":
        raise UnsafeRedis(
            f"Redis has maxmemory-policy {name}, which loses jobs. Set it to noeviction."
        )


__all__ = ["UNREACHABLE", "RedisError", "UnsafeRedis", "connect", "require_noeviction"]
