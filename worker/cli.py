"""`mpf worker`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from service.settings import Settings


@click.command()
@click.option(
    "--queues",
    metavar="NAME,NAME",
    help="Take jobs from these only, the first ones first: extract, fit-small, fit-large "
    "(MPF_QUEUES; all three in this order if not given).",
)
def worker(queues: str | None) -> None:
    """Run jobs from the queues at MPF_REDIS_URL, one at a time, until stopped."""
    from service.artifacts.base import NoSuchStore
    from service.connection import UnsafeRedis
    from worker.main import run_worker
    from worker.warmup import warming

    settings = settings_with(queues)
    try:
        with warming(settings):
            run_worker(settings)
    except (NoSuchStore, UnsafeRedis) as error:
        raise click.ClickException(str(error)) from error


def settings_with(queues: str | None) -> Settings:
    """The settings of the environment with other queues; raises BadParameter."""
    from service.settings import QUEUES, Settings

    if queues is None:
        return Settings()
    names = tuple(name.strip() for name in queues.split(",") if name.strip())
    unknown = sorted(set(names) - set(QUEUES))
    if unknown or not names:
        raise click.BadParameter(
            f"there is no queue {', '.join(unknown) or 'in it'}; there are {', '.join(QUEUES)}",
            param_hint="--queues",
        )
    return Settings(queues=names)  # type: ignore[arg-type]
