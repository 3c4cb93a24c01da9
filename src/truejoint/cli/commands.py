"""The commands of `truejoint`: where each is, what it does, an example; imported when called."""

from functools import cache
from importlib import import_module
from typing import Annotated, Any, Final, NamedTuple

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

import truejoint
from truejoint.cli.options import described
from truejoint.toml_file import shipped_table


class Command(NamedTuple):
    """A command as a line in the list of commands."""

    panel: str
    summary: str
    example: str  # its arguments
    place: str = ""  # module and function of this package, where its words do not say them


_TABLE: Final = shipped_table(__package__, "commands.toml")
COMMANDS: Final = {
    name: Command(panel, **row)
    for panel, rows in _TABLE["panels"].items()
    for name, row in rows.items()
}
GROUPS: Final[dict[str, str]] = _TABLE["groups"]  # what each is for
HINTS: Final = {word: hint for words, hint in _TABLE["hints"].items() for word in words.split()}
_HOW: Final[dict[str, Any]] = {
    "rich_markup_mode": "markdown",
    "pretty_exceptions_enable": False,
    "context_settings": {"help_option_names": ["-h", "--help"]},
}


class _LazyGroup(TyperGroup):
    """Group that lists its commands by stand-ins, and imports the one that is called."""

    prefix = ""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        for name, entry in COMMANDS.items():
            word = name.removeprefix(self.prefix).split()[0]
            if name.startswith(self.prefix) and word not in self.commands:
                summary = GROUPS.get(self.prefix + word, entry.summary)
                panel = None if self.prefix else entry.panel
                self.commands[word] = TyperCommand(word, help=summary, rich_help_panel=panel)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Give the command that a line names, imported; refuse another with what is meant."""
        typed = args[0]
        if typed not in self.commands and not ctx.resilient_parsing:
            nested = [f"`truejoint {name}`" for name in COMMANDS if name.endswith(f" {typed}")]
            if typed in HINTS:
                ctx.fail(f"No such command {typed!r}: {HINTS[typed]}.")
            if nested:
                ctx.fail(f"No such command {typed!r}. Did you mean {' or '.join(nested)}?")
        word, stand_in, rest = super().resolve_command(ctx, args)
        return word, stand_in and command(f"{self.prefix}{word}"), rest


@cache
def command(name: str) -> Any:
    """Command, or group of commands, of words like ``"node record"``; imports it."""
    is_group = name in GROUPS
    shown = next(n for n in COMMANDS if n.startswith(f"{name} ")) if is_group else name
    epilog = f"Example: `truejoint {shown} {COMMANDS[shown].example}`"
    word = name.rpartition(" ")[2]
    app = typer.Typer(name=word, add_completion=False, **_HOW)
    if is_group:
        kind = type("_Group", (_LazyGroup,), {"prefix": f"{name} "})
        app.callback(cls=kind, help=GROUPS[name], epilog=epilog, no_args_is_help=True)(lambda: None)
    else:
        place = COMMANDS[name].place or f"{name.partition(' ')[0]}:{word}"
        module, _, function = place.partition(":")
        called = getattr(import_module(f"truejoint.cli.{module}"), function)
        app.command(word, epilog=epilog)(described(called))
    return get_command(app)


app = typer.Typer(
    name="truejoint",
    cls=_LazyGroup,
    no_args_is_help=True,
    help="Tell where a cable-driven joint really is: calibrate, correct, and judge the error.",
    epilog="Example: `truejoint demo` shows the whole way on a simulated RAVEN-II.",
    **_HOW,
)


def _print_version(is_asked: bool) -> None:
    if is_asked:
        typer.echo(f"truejoint {truejoint.__version__}")
        raise typer.Exit


@app.callback()
def root(
    show_version: Annotated[
        bool,
        typer.Option("--version", callback=_print_version, is_eager=True, help="Show the version."),
    ] = False,
    debug: Annotated[
        bool, typer.Option("--debug", help="Show where in the program an error came from.")
    ] = False,
) -> None:
    """Tell where a cable-driven joint really is."""
    del show_version, debug  # what asks for them has already answered


@cache
def built() -> Any:
    """Command that parses a line and does what it says."""
    return get_command(app)
