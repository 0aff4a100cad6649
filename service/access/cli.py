"""`mpf keys`: who may use the service from elsewhere."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from service.access.store import KeyStore


@click.group()
@click.option(
    "--data-dir",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path("mpf-data"),
    show_default=True,
    envvar="MPF_DATA_DIR",
    help="That of `mpf serve`; it may be running or not.",
)
@click.option("--redis-url", envvar="MPF_REDIS_URL", default=None, help="Instead of --data-dir.")
@click.pass_context
def keys(context: click.Context, data_dir: Path, redis_url: str | None) -> None:
    """Make, list and revoke API keys."""
    context.obj = (data_dir, redis_url)


@keys.command()
@click.argument("name")
@click.pass_obj
def create(where: tuple[Path, str | None], name: str) -> None:
    """Make a key for NAME and show its token, once."""
    with _store(*where) as store:
        key, token = store.create(name)
    click.echo(f"key {key.id} for {name}; its token is shown only now:", err=True)
    click.echo(token)


@keys.command("list")
@click.pass_obj
def list_keys(where: tuple[Path, str | None]) -> None:
    """Show all keys; tokens are not kept and cannot be shown."""
    with _store(*where) as store:
        for key in store.all():
            made = datetime.fromtimestamp(key.created_at, UTC).isoformat(timespec="seconds")
            click.echo(f"{key.id}  {made}  {'revoked' if key.revoked else 'valid  '}  {key.name}")


@keys.command()
@click.argument("key_id", metavar="ID")
@click.pass_obj
def revoke(where: tuple[Path, str | None], key_id: str) -> None:
    """End a key; its jobs stay until they expire."""
    with _store(*where) as store:
        if not store.revoke(key_id):
            raise click.ClickException(f"There is no key {key_id}.")


@contextmanager
def _store(data_dir: Path, redis_url: str | None) -> Iterator[KeyStore]:
    from service.access.store import KeyStore
    from service.connection import RedisError, connect
    from service.embedded import NoServer
    from service.serving import CannotServe, embedded_running
    from service.settings import Settings

    try:
        with embedded_running(data_dir, redis_url) as url:
            redis = connect(Settings(redis_url=url))
            yield KeyStore(redis)
            redis.close()
    except (CannotServe, NoServer, RedisError) as error:
        raise click.ClickException(str(error)) from error
