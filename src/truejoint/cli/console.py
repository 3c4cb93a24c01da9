"""What the command line prints: progress on standard error, results on standard output."""

import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment

from truejoint.errors import printable

# A file or pipe has no width of its own; neither tables nor lines are to be folded there.
_LOG_WIDTH = 132


def one_line(text: str) -> str:
    """Text as one line that is not too long."""
    return shortened(" ".join(text.splitlines()))


def shortened(text: str, most: int = 1000) -> str:
    """Beginning and end of a text of more than `most` characters."""
    return text if len(text) <= most else f"{text[: most // 2]} ... {text[-most // 2 :]}"


class _Console(Console):
    """Console whose every piece of text is `printable`; brackets and colons in it are no markup."""

    def __init__(self, *, stderr: bool) -> None:
        stream = sys.stderr if stderr else sys.stdout
        terminal = stream is not None and stream.isatty()
        super().__init__(
            stderr=stderr, width=None if terminal else _LOG_WIDTH, soft_wrap=not terminal,
            markup=False, emoji=False, highlight=False,
        )  # fmt: skip

    def render(
        self, renderable: RenderableType, options: ConsoleOptions | None = None
    ) -> Iterator[Segment]:
        for part in super().render(renderable, options):
            yield part if part.control else part._replace(text=printable(part.text))


out, err = _Console(stderr=False), _Console(stderr=True)


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
_TELLING = 0.01  # share done from which on the time left can be told: what is first also compiles


@contextmanager
def progress(description: str) -> Iterator[Progress]:
    """Show one step of long work; yields a callback that takes the fraction done, 0 to 1.

    A terminal gets a bar with the time left; a file or pipe gets a line at the start, one
    every ten seconds and one at the end.
    """
    began, description = time.monotonic(), one_line(description)
    if err.is_terminal:
        from rich import progress as rich  # not for help

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
        seconds = (now - began) * (1 - fraction) / fraction
        remaining = f", about {seconds:.0f} s left" if fraction >= _TELLING else ""
        after = f": {doing}" if doing != description else ""
        err.print(f"  {fraction:.0%}{remaining}{after}")

    yield Progress(report, description)
    err.print(f"  done in {time.monotonic() - began:.1f} s")


def print_table(
    header: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    title: str | None = None,
    numbers: bool = True,
) -> None:
    """Print a table: texts in the first column, in the others `numbers` or texts."""
    from rich.table import Table

    table = Table(title=title and one_line(title), title_justify="left")
    texts = [[*map(one_line, row)] for row in rows]
    for n, name in enumerate(header):
        table.add_column(name, justify="right" if n and numbers else "left", overflow="fold")
    for row in texts:
        table.add_row(*row)
    table.columns[0].no_wrap = all(len(row[0]) <= 30 for row in texts)  # short names stay whole
    out.print(table)


def print_facts(title: str, facts: Iterable[tuple[str, str]]) -> None:
    """Print a name and a text in each line."""
    from rich.table import Table

    table = Table(show_header=False, title=title, title_justify="left")
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for name, text in facts:
        table.add_row(one_line(name), shortened(text, 10_000))
    out.print(table)


def say(message: str) -> None:
    """Tell the person what is going on; never part of the result."""
    err.print(one_line(message))


def result_json(values: Mapping[str, Any]) -> None:
    """Print the result as one JSON document, in place of text, where ``--json`` asked for it."""
    if out.quiet:
        import json  # not for help

        sys.stdout.write(json.dumps(values, indent=2, allow_nan=False) + "\n")


def command_line() -> str:
    """Give the command line as it was typed, to go into what it makes."""
    import shlex  # not for help

    return printable(shlex.join(["truejoint", *sys.argv[1:]]))
