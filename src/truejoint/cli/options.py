"""How options are read: each is a parameter of its command, and described in `help.toml`."""

from __future__ import annotations

import inspect
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import is_dataclass
from functools import cache, wraps
from importlib import resources
from typing import Annotated, Any, Final, NamedTuple, get_origin

import typer

import truejoint
from truejoint.cli import complete
from truejoint.cli.console import out, result_json
from truejoint.errors import CommandRefused
from truejoint.estimators.registry import OWN

CHECK_FAILED: Final = 1


def share(percent: float | None) -> float | None:
    """Probability of so many percent, where they are given; raises CommandRefused if it is none."""
    if percent is None:
        return None
    if not 0.0 < percent < 100.0:
        raise CommandRefused(f"--level {percent:g}: give a probability between 0 and 100 %, as 90")
    return percent / 100.0


def split_pairs(option: str, texts: Sequence[str] | None, form: str) -> dict[str, str]:
    """Values by key of texts like ``KEY=VALUE``; raises CommandRefused for others, or one twice."""
    values: dict[str, str] = {}
    for text in texts or ():
        key, separator, value = text.partition("=")
        if not separator:
            raise CommandRefused(f"{option} {text!r:.60}: write {form}")
        if key in values:
            raise CommandRefused(f"{option} {text!r:.60}: {key} was given before; give it once")
        values[key] = value
    return values


def number(option: str, text: str, value: str) -> float:
    """Read the number in the `text` of an option; raises CommandRefused if it is none."""
    try:
        return float(value)
    except ValueError:
        raise CommandRefused(f"{option} {text!r:.60}: {value!r:.40} is no number") from None


def robot_and_arm(text: str) -> tuple[str, str]:
    """Split ``"raven2:right"`` into robot and arm; the arm is empty where none is named."""
    name, separator, arm = text.rpartition(":")
    return (name, arm) if separator else (text, "")


def get_robot(text: str) -> truejoint.robots.Robot:
    """Look up the robot arm of ``"raven2:right"``; raises RobotError if there is none."""
    return truejoint.get_robot(*robot_and_arm(text))


class Result(NamedTuple):
    """What a command gives back: `values` for ``--json``, and whether what it judged has passed."""

    values: Mapping[str, Any]
    passed: bool = True


def described(command: Callable[..., Result | None]) -> Callable[..., None]:
    """Make of a command what typer takes: every option with what `help.toml` says of it.

    A parameter whose type is a dataclass stands for options that are its fields. An option is
    described in the section of that class, of the command (its module, or module and function), or
    in ``shared``. A command that returns a `Result` has ``--json``, and exit code 1 if that has not
    passed.
    """
    signature = inspect.signature(command, eval_str=True)
    module = command.__module__.rpartition(".")[2]
    sections = (f"{module}.{command.__name__}", module)
    groups: dict[str, tuple[Any, list[str]]] = {}
    parameters = []
    for name, parameter in signature.parameters.items():
        if is_dataclass(kind := parameter.annotation):
            fields = inspect.signature(kind, eval_str=True).parameters  # type: ignore[arg-type]
            groups[name] = kind, list(fields)
            group_sections = (getattr(kind, "__name__", ""), *sections)
            parameters += [_described(each, group_sections) for each in fields.values()]
        else:
            parameters.append(_described(parameter, sections))
    if signature.return_annotation in (Result, Result | None):
        keyword = inspect.Parameter.KEYWORD_ONLY
        as_json = inspect.Parameter("as_json", keyword, default=False, annotation=bool)
        parameters.append(_described(as_json, sections))

    @wraps(command)
    def run(**values: Any) -> None:
        out.quiet = values.pop("as_json", False)
        for name, (kind, fields) in groups.items():
            values[name] = kind(**{field: values.pop(field) for field in fields})
        result = command(**values)
        if result is not None:
            result_json(result.values)
            if not result.passed:
                raise typer.Exit(CHECK_FAILED)

    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {each.name: each.annotation for each in parameters}
    return run


@cache
def _help() -> dict[str, Any]:
    text = resources.files(__package__).joinpath("help.toml").read_text(encoding="utf-8")
    return tomllib.loads(text.replace("{estimators}", ", ".join(OWN)))


def _described(parameter: inspect.Parameter, sections: tuple[str, ...]) -> inspect.Parameter:
    """Give a parameter its option or argument, unless the command itself has stated one."""
    parameter = parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY)
    kind, name = parameter.annotation, parameter.name
    if kind is typer.Context or get_origin(kind) is Annotated:
        return parameter
    pages = (_help().get(section, {}) for section in (*sections, "shared"))
    entry = next((page[name] for page in pages if name in page), None)
    if entry is None:
        raise TypeError(f"help.toml says nothing of {name} of {sections[-1]}")
    make = typer.Argument if entry.get("argument") else typer.Option
    how = {key: entry[key] for key in ("help", "metavar", "min", "max") if key in entry}
    if "panel" in entry:
        how["rich_help_panel"] = entry["panel"]
    if "complete" in entry:
        how["autocompletion"] = complete.named(entry["complete"])
    return parameter.replace(annotation=Annotated[kind, make(*entry.get("flags", ()), **how)])
