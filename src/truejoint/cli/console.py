"""What the command line prints: progress on standard error, results on standard output."""

from __future__ import annotations

import json
import shlex
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, cast

if TYPE_CHECKING:  # a shell that completes a word waits for what is imported
    from rich.console import Console

# A file or pipe has no width of its own; tables are not to be folded there.
_LOG_WIDTH = 132


class _Console:
    """Console that prints names of files and data as they are: brackets in them are no markup.

    It is made when something is first printed.
    """

    def __init__(self, *, stderr: bool) -> None:
        self._stderr = stderr

    def __getattr__(self, name: str) -> Any:
        return getattr(self._made, name)

    @cached_property
    def _made(self) -> Console:
        from rich.console import Console  # noqa: PLC0415

        terminal = (sys.stderr if self._stderr else sys.stdout).isatty()
        width = None if terminal else _LOG_WIDTH
        return Console(stderr=self._stderr, width=width, markup=False, highlight=False)


out, err = cast("Console", _Console(stderr=False)), cast("Console", _Console(stderr=True))


@dataclass
class Progress:
    """Callback that takes the fraction done, 0 to 1, of long work."""

    show: Callable[[float, str], None]
    doing: str
    fraction: float = 0.0

    def __call__(self, fraction: float) -> None:
        """Show the fraction done."""
        self.fraction = fraction
        self.show(fraction, self.doing)

    def say(self, doing: str) -> None:
        """Show what is being done now."""
        self.doing = doing
        self(self.fraction)


# A log file has no bar that moves: say there how far a long step is, this often [s].
_LOG_PERIOD = 10.0


@contextmanager
def progress(description: str) -> Iterator[Progress]:
    """Show one step of long work; yields a callback that takes the fraction done, 0 to 1.

    A terminal gets a bar with the time left; a file or pipe gets a line at the start, one
    every ten seconds and one at the end.
    """
    began = time.monotonic()
    if err.is_terminal:
        from rich import progress as rich  # noqa: PLC0415  # not for help

        columns = rich.Progress.get_default_columns()[1:]
        what = rich.TextColumn("{task.description}", markup=False)
        with rich.Progress(what, *columns, console=err) as bar:
            task = bar.add_task(description, total=1.0)
            yield Progress(
                lambda fraction, doing: bar.update(task, completed=fraction, description=doing),
                description,
            )
            bar.update(task, completed=1.0)
        return
    err.print(f"{description} ...")
    said = began

    def report(fraction: float, doing: str) -> None:
        nonlocal said
        now = time.monotonic()
        if now - said < _LOG_PERIOD or not 0 < fraction < 1:
            return
        said = now
        left = (now - began) * (1 - fraction) / fraction
        after = f": {doing}" if doing != description else ""
        err.print(f"  {fraction:.0%}, about {left:.0f} s left{after}")

    yield Progress(report, description)
    err.print(f"  done in {time.monotonic() - began:.1f} s")


def print_table(
    header: Sequence[str], rows: Iterable[Sequence[str]], *, title: str | None = None
) -> None:
    """Print a table: texts in the first column, numbers in the others."""
    from rich.table import Table  # noqa: PLC0415

    table = Table(title=title, title_justify="left")
    for name in header:
        table.add_column(name, justify="left" if name == header[0] else "right")
    for row in rows:
        table.add_row(*row)
    out.print(table)


def print_facts(title: str, facts: Iterable[tuple[str, str]]) -> None:
    """Print a name and a text in each line."""
    from rich.table import Table  # noqa: PLC0415

    table = Table(show_header=False, title=title, title_justify="left")
    for row in facts:
        table.add_row(*row)
    out.print(table)


def say(message: str) -> None:
    """Tell the person what is going on; never part of the result."""
    err.print(message)


def result_json(values: Mapping[str, Any]) -> None:
    """Print the result as one JSON document and nothing else."""
    sys.stdout.write(json.dumps(values, indent=2, allow_nan=False) + "\n")


def command_line() -> str:
    """Give the command line as it was typed, to go into what it makes."""
    return shlex.join(["truejoint", *sys.argv[1:]])
