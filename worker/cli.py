"""`mpf worker`."""

from __future__ import annotations

import click


@click.command()
def worker() -> None:
    """Run jobs from the queue at MPF_REDIS_URL, one at a time, until stopped."""
    from service.artifacts.base import NoSuchStore
    from service.connection import UnsafeRedis
    from service.settings import Settings
    from worker.main import run_worker

    try:
        run_worker(Settings())
    except (NoSuchStore, UnsafeRedis) as error:
        raise click.ClickException(str(error)) from error
