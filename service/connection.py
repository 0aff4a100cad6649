"""One way to reach Redis, with time-outs on everything.

    redis://[user:password@]host:6379/0     rediss://…?ssl_ca_certs=/path   over TLS
    unix://[user:password@]/path.sock
    redis+sentinel://[user:password@]host:26379,host:26379/name[/0]         the primary called so
    rediss+sentinel://…                                                     the same over TLS

Options of the connection stand in the query. Those that begin with `sentinel_` are for the
Sentinels (`sentinel_username`, `sentinel_password`). A cluster is not among them: scripts touch
keys of several slots.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any
from urllib.parse import parse_qsl, unquote, urlsplit

from redis import Redis
from redis.asyncio import Redis as AsyncRedis
from redis.asyncio.retry import Retry as AsyncRetry
from redis.asyncio.sentinel import Sentinel as AsyncSentinel
from redis.backoff import ExponentialBackoff
from redis.exceptions import ConnectionError as RedisConnectionError
from redis.exceptions import RedisError, ResponseError
from redis.exceptions import TimeoutError as RedisTimeoutError
from redis.retry import Retry
from redis.sentinel import Sentinel

from service.settings import Settings

# What a caller meets while Redis is away, restarting, loading its file or failing over.
UNREACHABLE = (RedisConnectionError, RedisTimeoutError)

SENTINEL_PORT = 26379


class UnsafeRedis(Exception):
    """This Redis would lose jobs, or cannot be used; str() says why and what to do."""


def connect(settings: Settings) -> Redis:
    """A client whose every call ends: 2 s to connect, 5 s per command, two quick retries."""
    options: Any = _limits() | {"retry": Retry(_backoff(), retries=2)}
    if not _watched(settings.redis_url):
        return Redis.from_url(settings.redis_url, **options)
    place = Watched.at(settings.redis_url)
    guards: Any = Sentinel(  # type: ignore[no-untyped-call]
        place.hosts, sentinel_kwargs=_quick() | place.for_sentinels, **place.options
    )
    primary: Redis = guards.master_for(place.name, db=place.db, **options)
    return primary


def connect_async(settings: Settings, **changes: Any) -> AsyncRedis:
    """The same for an event loop."""
    options: Any = _limits() | {"retry": AsyncRetry(_backoff(), retries=2)} | changes
    if not _watched(settings.redis_url):
        return AsyncRedis.from_url(settings.redis_url, **options)
    place = Watched.at(settings.redis_url)
    guards: Any = AsyncSentinel(  # type: ignore[no-untyped-call]
        place.hosts, sentinel_kwargs=_quick() | place.for_sentinels, **place.options
    )
    primary: AsyncRedis = guards.master_for(place.name, db=place.db, **options)
    return primary


@dataclass(frozen=True)
class Watched:
    """A primary that Sentinels watch: where they are, and what they call it."""

    hosts: list[tuple[str, int]]
    name: str
    db: int
    options: dict[str, Any]
    for_sentinels: dict[str, Any]

    @classmethod
    def at(cls, url: str) -> Watched:
        """Raises UnsafeRedis for a URL that names none."""
        parts = urlsplit(url)
        login, _, hosts = parts.netloc.rpartition("@")
        user, _, password = login.partition(":")
        name, _, db = parts.path.strip("/").partition("/")
        if not hosts or not name or not (db or "0").isdigit():
            raise UnsafeRedis(
                "MPF_REDIS_URL names no primary. Write redis+sentinel://host:26379,host:26379/name."
            )
        given = dict(parse_qsl(parts.query))
        secure: dict[str, Any] = {"ssl": True} if parts.scheme.startswith("rediss") else {}
        plain = {key: value for key, value in given.items() if not key.startswith("sentinel_")}
        own = {
            key.removeprefix("sentinel_"): value
            for key, value in given.items()
            if key.startswith("sentinel_")
        }
        who = {"username": unquote(user), "password": unquote(password)}
        return cls(
            hosts=[_host_and_port(host) for host in hosts.split(",")],
            name=unquote(name),
            db=int(db or 0),
            options=secure | plain | {key: value for key, value in who.items() if value},
            for_sentinels=secure | plain | own,
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


def _watched(url: str) -> bool:
    return urlsplit(url).scheme in ("redis+sentinel", "rediss+sentinel")


def _host_and_port(text: str) -> tuple[str, int]:
    parts = urlsplit(f"//{text}")
    return parts.hostname or "", parts.port or SENTINEL_PORT


def _quick() -> dict[str, Any]:
    return {"socket_connect_timeout": 2.0, "socket_timeout": 2.0}


def _limits() -> dict[str, Any]:
    return {
        "socket_connect_timeout": 2.0,
        "socket_timeout": 5.0,
        "health_check_interval": 15,
        "retry_on_error": list(UNREACHABLE),
    }


def _backoff() -> ExponentialBackoff:
    return ExponentialBackoff(cap=0.2, base=0.02)


__all__ = ["UNREACHABLE", "RedisError", "UnsafeRedis", "connect", "connect_async",
           "require_noeviction"]  # fmt: skip
