"""How options are read: each is a parameter of its command, and described in `help.toml`."""

from __future__ import annotations

import inspect
import tomllib
from collections.abc import Callable
from functools import cache, wraps
from importlib import resources
from typing import Annotated, Any, get_origin

import typer

import truejoint
from truejoint.cli import complete
from truejoint.errors import CommandRefused
from truejoint.estimators.registry import OWN


def share(percent: float | None) -> float | None:
    """Probability of so many percent, where they are given; raises CommandRefused if it is none."""
    if percent is None:
        return None
    if not 0.0 < percent < 100.0:
        raise CommandRefused(f"--level {percent:g}: give a probability between 0 and 100 %, as 90")
    return percent / 100.0


def robot_and_arm(text: str) -> tuple[str, str]:
    """Split ``"raven2:right"`` into robot and arm; the arm is empty where none is named."""
    name, separator, arm = text.rpartition(":")
    return (name, arm) if separator else (text, "")


def get_robot(text: str) -> truejoint.robots.Robot:
    """Look up the robot arm of ``"raven2:right"``; raises RobotError if there is none."""
    return truejoint.get_robot(*robot_and_arm(text))


def takes(**groups: type) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Give a command the options that are the fields of dataclasses; it takes each by its name."""

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        command.groups = groups  # type: ignore[attr-defined]
        return command

    return decorate


def described(command: Callable[..., None]) -> Callable[..., None]:
    """Make of a command what typer takes: every option with what `help.toml` says of it.

    An option is described in the section of its group's class, of the command (its module, or
    module and function), or in ``shared``.
    """
    groups: dict[str, type] = getattr(command, "groups", {})
    module = command.__module__.rpartition(".")[2]
    sections = (f"{module}.{command.__name__}", module)
    fields = {name: inspect.signature(kind, eval_str=True).parameters
              for name, kind in groups.items()}  # fmt: skip
    parameters = []
    for name, parameter in inspect.signature(command, eval_str=True).parameters.items():
        if name in groups:
            of_group = (groups[name].__name__, *sections)
            parameters += [_described(each, of_group) for each in fields[name].values()]
        else:
            parameters.append(_described(parameter, sections))

    @wraps(command)
    def run(**values: Any) -> None:
        made = {
            name: groups[name](**{field: values.pop(field) for field in fields[name]})
            for name in groups
        }
        command(**values, **made)

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
        how["autocompletion"] = getattr(complete, entry["complete"])
    return parameter.replace(annotation=Annotated[kind, make(*entry.get("flags", ()), **how)])
