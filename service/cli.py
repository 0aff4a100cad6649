"""`mpf serve` and `mpf api`; what is heavy is imported inside the commands."""

from __future__ import annotations

import ipaddress
from pathlib import Path

import click


@click.command()
@click.option("--host", default="127.0.0.1", show_default=True, help="Address to listen on.")
@click.option("--port", default=8000, show_default=True, help="Port; 0 takes a free one.")
@click.option(
    "--data-dir",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path("mpf-data"),
    show_default=True,
    envvar="MPF_DATA_DIR",
    help="Folder of inputs, results and the embedded Valkey.",
)
@click.option(
    "--workers",
    type=click.IntRange(1, 256),
    default=1,
    show_default=True,
    envvar="MPF_WORKERS",
    help="Jobs that run at the same time; the cores are shared among them.",
)
@click.option(
    "--redis-url",
    envvar="MPF_REDIS_URL",
    default=None,
    help="A Valkey or Redis that is already there, instead of the embedded one.",
)
def serve(host: str, port: int, data_dir: Path, workers: int, redis_url: str | None) -> None:
    """The whole service: Valkey, API and workers, until Ctrl-C."""
    from service.connection import UnsafeRedis
    from service.embedded import NoServer
    from service.serving import CannotServe, Plan
    from service.serving import serve as run

    require_loopback(host)
    try:
        run(Plan(host, port, data_dir, workers, redis_url))
    except (CannotServe, NoServer, UnsafeRedis) as error:
        raise click.ClickException(str(error)) from error


@click.command()
@click.option("--host", default="127.0.0.1", show_default=True, help="Address to listen on.")
@click.option("--port", default=8000, show_default=True, help="Port.")
@click.option("--fd", type=int, default=None, hidden=True, help="A socket that listens already.")
def api(host: str, port: int, fd: int | None) -> None:
    """The HTTP API alone, against MPF_REDIS_URL and MPF_DATA_DIR."""
    import uvicorn

    from service.app import create_app
    from service.connection import RedisError, UnsafeRedis, connect, require_noeviction
    from service.logs import configure_logging
    from service.settings import Settings

    if fd is None:
        require_loopback(host)
    settings = Settings()
    configure_logging()
    try:
        require_noeviction(connect(settings))
    except UnsafeRedis as error:
        raise click.ClickException(str(error)) from error
    except RedisError:
        pass  # Redis may come later; until then the API answers 503
    uvicorn.run(
        create_app(settings),
        host=host,
        port=port,
        fd=fd,
        log_level="warning",
        server_header=False,
        timeout_graceful_shutdown=5,
    )


def require_loopback(host: str) -> None:
    """Without API keys only this machine may reach the service."""
    try:
        loopback = ipaddress.ip_address(host).is_loopback
    except ValueError:
        loopback = host == "localhost"
    if not loopback:
        raise click.ClickException(
            f"{host} can be reached from other machines, and there are no API keys: anybody could "
            "run jobs and read results. Listen on 127.0.0.1 and put a proxy that authenticates in "
            "front."
        )
