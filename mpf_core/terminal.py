"""What the commands share: a sentence and an exit code for every error, a line of progress."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

from mpf_core.errors import Cancelled, InputError, MPFError, OptionsError
from mpf_core.progress import Progress

EXIT_INPUT, EXIT_FIT, EXIT_CANCELLED = 2, 3, 130


@contextmanager
def told_errors(input: Path) -> Iterator[None]:
    """End the process with a sentence on stderr where the block raises; `input` is its file."""
    try:
        yield
    except KeyboardInterrupt:
        sys.exit(_fail(Cancelled("interrupted"), EXIT_CANCELLED))
    except InputError as error:
        sys.exit(_fail(error, EXIT_INPUT))
    except Cancelled as error:
        sys.exit(_fail(error, EXIT_CANCELLED))
    except MPFError as error:
        sys.exit(_fail(error, EXIT_FIT))
    except OSError as error:
        name = error.filename or input
        sys.exit(_fail(InputError(f"{error.strerror or error}", where=str(name)), EXIT_INPUT))


def _fail(error: MPFError, code: int) -> int:
    click.echo(f"mpf: {error} [{error.code}]", err=True)
    return code


def check_output(path: Path, *suffixes: str, option: str = "--output") -> None:
    """Raise OptionsError unless `path` ends in one of `suffixes` (if any), in a folder that is."""
    if suffixes and path.suffix.lower() not in suffixes:
        kinds = "neither " + " nor ".join(suffixes) if len(suffixes) > 1 else f"no {suffixes[0]}"
        raise OptionsError(f"{path.name} is {kinds}", where=option, advice="Name it so.")
    if not path.parent.is_dir():
        raise OptionsError(
            f"there is no folder {path.parent}", where=option, advice="Make it first."
        )


def changes_in(flags: dict[str, Any]) -> dict[str, Any]:
    """Option names to values: flags that were given, and --set NAME=VALUE read as JSON or text."""
    changes = {name: value for name, value in flags.items() if value is not None}
    for setting in changes.pop("settings", ()):
        name, equals, text = setting.partition("=")
        if not equals:
            raise OptionsError(f"--set {setting!r} has no '='", advice="Write --set NAME=VALUE.")
        try:
            changes[name] = json.loads(text)
        except ValueError:  # not JSON, or a number of more digits than Python reads
            changes[name] = text
    return changes


class ProgressLine:
    """One live line on a terminal; a plain line every few seconds elsewhere."""

    EVERY = 5.0  # seconds between plain lines

    def __init__(self) -> None:
        self.live = sys.stderr.isatty()
        self.last_stage, self.last_time = "", -1e9

    def show(self, progress: Progress) -> None:
        """Tell it, unless something like it was told just now."""
        text = self.text(progress)
        if self.live:
            click.echo(f"\r\033[K{text}", nl=False, err=True)
        elif progress.stage != self.last_stage or (progress.seconds - self.last_time >= self.EVERY):
            self.last_stage, self.last_time = progress.stage, progress.seconds
            click.echo(text, err=True)

    def text(self, progress: Progress) -> str:
        """What there is to tell, in one line."""
        parts = [f"{progress.fraction:4.0%}  {progress.stage}"]
        if progress.iteration is not None:
            parts.append(f"{progress.iteration}/{progress.iterations}")
        if progress.loss is not None:
            parts.append(f"loss {progress.loss:.4f}")
        if progress.eta is not None:
            parts.append(f"{progress.eta:.0f} s left")
        return "  ".join(parts)

    def end(self) -> None:
        """Clear the line."""
        if self.live:
            click.echo("\r\033[K", nl=False, err=True)
