"""How options are read: each is a parameter of its command, and described in `help.toml`."""

import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import is_dataclass
from functools import partial, wraps
from typing import Annotated, Any, Final, NamedTuple

import typer

import truejoint
from truejoint.cli.console import out, result_json
from truejoint.errors import CommandRefused, unknown
from truejoint.summary import json_values
from truejoint.toml_file import shipped_table
from truejoint.units import display_unit

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


def joint_values(
    option: str, texts: Sequence[str] | None, units: Mapping[str, str]
) -> dict[str, float]:
    """Read texts like ``elbow=0.2``, in deg or mm, as values [rad or m] by joint of the `units`."""
    values = {}
    for joint, text in split_pairs(option, texts, "JOINT=VALUE").items():
        if joint not in units:
            raise CommandRefused(f"{option} {unknown('joint', joint, units)}")
        shown = display_unit(units[joint])
        value = number(option, f"{joint}={text}", text.removesuffix(shown.name))
        if not math.isfinite(value):
            raise CommandRefused(f"{option} {joint}={text}: give a finite number of {shown.name}")
        values[joint] = value / shown.scale
    return values


def robot_and_arm(text: str) -> tuple[str, str]:
    """Split ``"raven2:right"`` into robot and arm; the arm is empty where none is named."""
    name, separator, arm = text.rpartition(":")
    return (name, arm) if separator else (text, "")


def get_robot(text: str) -> "truejoint.robots.Robot":
    """Look up the robot arm of ``"raven2:right"``; raises RobotError if there is none."""
    return truejoint.get_robot(*robot_and_arm(text))


def make_twin(robot: str, **how: Any) -> "truejoint.simulation.Twin":
    """Make the digital twin of the robot arm of ``"raven2:right"``, `how` as for every twin."""
    return truejoint.simulation.make_twin(*robot_and_arm(robot), **how)


class Result(NamedTuple):
    """What a command gives back: `values` for ``--json``, and whether what it judged has passed."""

    values: Mapping[str, Any]
    passed: bool = True


def described(command: Callable[..., Result | None]) -> Callable[..., None]:
    """Make of a command what typer takes: every option with what `help.toml` says of it.

    A parameter whose type is a dataclass stands for options that are its fields. An option is
    described in the section of that class, of the command (its module, or module and function), or
    in ``shared``, with options of which it needs one, or that it excludes. A command that returns a
    `Result` has ``--json``, and exit code 1 if that has not passed.
    """
    signature = inspect.signature(command, eval_str=True)
    module = command.__module__.rpartition(".")[2]
    sections = (f"{module}.{command.__name__}", module)
    groups: dict[str, tuple[Any, list[str]]] = {}
    parameters: list[inspect.Parameter] = []
    entries: dict[str, dict[str, Any]] = {}

    def add(parameter: inspect.Parameter, *sections: str) -> None:
        entries[parameter.name] = entry = _entry(parameter, sections)
        parameter = parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY)
        parameters.append(_described(parameter, entry))

    for name, parameter in signature.parameters.items():
        if is_dataclass(kind := parameter.annotation):
            fields = inspect.signature(kind, eval_str=True).parameters  # type: ignore[arg-type]
            groups[name] = kind, list(fields)
            for each in fields.values():
                add(each, *(of.__name__ for of in getattr(kind, "__mro__", ())), *sections)
        else:
            add(parameter, *sections)
    if signature.return_annotation in (Result, Result | None):
        keyword = inspect.Parameter.KEYWORD_ONLY
        add(inspect.Parameter("as_json", keyword, default=False, annotation=bool), *sections)

    @wraps(command)
    def run(**values: Any) -> None:
        stated = {p.name for p in parameters if values.get(p.name) not in (None, p.default)}
        _check_together(stated, entries)
        out.quiet = values.pop("as_json", False)
        for name, (kind, fields) in groups.items():
            values[name] = kind(**{field: values.pop(field) for field in fields})
        result = command(**values)
        if result is not None:
            result_json(json_values(result.values))
            if not result.passed:
                raise typer.Exit(CHECK_FAILED)

    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {each.name: each.annotation for each in parameters}
    return run


def _entry(parameter: inspect.Parameter, sections: tuple[str, ...]) -> dict[str, Any]:
    """Gather what `help.toml` says of a parameter, each thing as the nearest section says it."""
    name, help_ = parameter.name, shipped_table(__package__, "help.toml")
    entry: dict[str, Any] = {"flags": [f"--{name.replace('_', '-')}"]}
    for section in ("shared", *reversed(sections)):
        said = help_.get(section, {}).get(name, {})
        entry |= {"help": said} if isinstance(said, str) else said
    if "help" not in entry:
        raise TypeError(f"help.toml says nothing of {name} of {sections[-1]}")
    return entry


def _check_together(stated: set[str], entries: Mapping[str, Mapping[str, Any]]) -> None:
    """Refuse options without any that they need, and beside one that they exclude."""
    typed = {
        name: entry.get("argument", "").strip("[]") or entry["flags"][0]
        for name, entry in entries.items()
    }
    for name in sorted(stated):
        needed, excluded = entries[name].get("needs", ()), entries[name].get("excludes", ())
        if needed and not stated & set(needed):
            of_command = (typed[other] for other in needed if other in typed)
            raise CommandRefused(f"{typed[name]} needs {' or '.join(of_command)}")
        for other in stated & set(excluded):
            raise CommandRefused(f"{typed[name]} and {typed[other]}: give one of the two")


def _described(parameter: inspect.Parameter, entry: Mapping[str, Any]) -> inspect.Parameter:
    how = {key: entry[key] for key in ("help", "metavar", "min", "max") if key in entry}
    make = partial(typer.Option, *entry["flags"])
    if entry.get("argument"):
        make = partial(typer.Argument, metavar=entry["argument"])
    option = make(**how, rich_help_panel=entry.get("panel"))
    return parameter.replace(annotation=Annotated[parameter.annotation, option])
