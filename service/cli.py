"""`mpf serve` and `mpf api`; what is heavy is imported inside the commands."""

from __future__ import annotations

import sys
from pathlib import Path

import click

# Between two turns of threads. Uploads are parsed and hashed in threads; polls wait for a turn.
SWITCH_SECONDS = 0.001


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
    from service.artifacts.base import NoSuchStore
    from service.connection import RedisError, UnsafeRedis, connect, require_noeviction
    from service.logs import configure_logging
    from service.serving import CannotServe, is_loopback, require_a_key
    from service.settings import Settings

    settings = Settings()
    configure_logging(settings)
    try:
        require_noeviction(connect(settings))
        if fd is None and not is_loopback(host):
            settings = settings.model_copy(update={"require_keys": True})
            require_a_key(host, settings)
    except (CannotServe, UnsafeRedis) as error:
        raise click.ClickException(str(error)) from error
    except RedisError:
        pass  # Redis may come later; until then the API answers 503
    try:
        app = create_app(settings)
    except NoSuchStore as error:
        raise click.ClickException(str(error)) from error
    sys.setswitchinterval(SWITCH_SECONDS)
    uvicorn.run(
        app,
        host=host,
        port=port,
        fd=fd,
        log_config=None,
        access_log=False,
        server_header=False,
        timeout_graceful_shutdown=5,
    )
