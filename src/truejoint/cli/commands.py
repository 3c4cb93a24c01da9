"""The commands of `truejoint`: where each is, what it does, an example; imported when called."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from importlib import import_module, resources
from typing import Annotated, Any, Final, NamedTuple

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

import truejoint
from truejoint.cli.options import described


class Command(NamedTuple):
    """A command as a line in the list of commands."""

    panel: str
    place: str  # module and function of this package
    summary: str
    example: str  # its arguments


_TABLE: Final = tomllib.loads(resources.files(__package__).joinpath("commands.toml").read_text())
COMMANDS: Final = {name: Command(**row) for name, row in _TABLE["commands"].items()}
GROUPS: Final = {name: row["help"] for name, row in _TABLE["groups"].items()}
_HOW: Final[dict[str, Any]] = {
    "rich_markup_mode": "markdown",
    "pretty_exceptions_enable": False,
    "context_settings": {"help_option_names": ["-h", "--help"]},
}


class _Commands(Mapping[str, Any]):
    """Commands of a group by name; one is imported when it is looked up, not when it is listed."""

    def __init__(self, group: str) -> None:
        self._prefix = f"{group} " if group else ""
        words = [name.removeprefix(self._prefix).split()[0] for name in COMMANDS
                 if name.startswith(self._prefix)]  # fmt: skip
        self._names = tuple(dict.fromkeys(words))

    def __getitem__(self, word: str) -> Any:
        if word not in self._names:
            raise KeyError(word)
        name = self._prefix + word
        return _group(name) if name in GROUPS else _command(name)

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def listed(self) -> dict[str, Any]:
        """Stand-ins that the list of commands is printed from, without an import."""
        stand_ins = {}
        for word in self:
            name = self._prefix + word
            panel = next(c.panel for n, c in COMMANDS.items() if f"{n} ".startswith(f"{name} "))
            summary = GROUPS[name] if name in GROUPS else COMMANDS[name].summary
            stand_ins[word] = TyperCommand(
                word, help=summary, rich_help_panel=None if self._prefix else panel
            )
        return stand_ins


class _LazyGroup(TyperGroup):
    """Group whose commands are imported when they are called."""

    group = ""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.commands = _Commands(self.group)  # type: ignore[assignment]  # click wants a dict

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Print the help with the list of commands."""
        with self._listed():
            super().format_help(ctx, formatter)

    def shell_complete(self, ctx: Any, incomplete: str) -> Any:
        """Complete the name of a command."""
        with self._listed():
            return super().shell_complete(ctx, incomplete)

    @contextmanager
    def _listed(self) -> Iterator[None]:
        """Have stand-ins in place of the commands, which are then not imported."""
        commands, self.commands = self.commands, self.commands.listed()  # type: ignore[attr-defined]
        try:
            yield
        finally:
            self.commands = commands


def _example(name: str) -> str:
    return f"Example: `truejoint {name} {COMMANDS[name].example}`"


@cache
def _command(name: str) -> Any:
    app = typer.Typer(add_completion=False, **_HOW)
    module, _, function = COMMANDS[name].place.partition(":")
    word = name.rsplit(maxsplit=1)[-1]
    command = getattr(import_module(f"truejoint.cli.{module}"), function)
    app.command(word, epilog=_example(name))(described(command))
    return get_command(app)


@cache
def _group(name: str) -> Any:
    kind = type("_Group", (_LazyGroup,), {"group": name})
    is_command = name in COMMANDS  # it does something by itself
    first = next(word for word in COMMANDS if word.startswith(f"{name} "))
    app = typer.Typer(
        name=name, cls=kind, help=GROUPS[name], epilog=_example(first), add_completion=False,
        no_args_is_help=not is_command, invoke_without_command=is_command, **_HOW,
    )  # fmt: skip
    callback = _nothing
    if is_command:
        module, _, function = COMMANDS[name].place.partition(":")
        callback = described(getattr(import_module(f"truejoint.cli.{module}"), function))
    app.callback()(callback)
    return get_command(app)


def _nothing() -> None:
    pass


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
