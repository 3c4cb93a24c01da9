"""The commands of `truejoint`: where each is, what it does, an example; imported when called."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache
from importlib import import_module
from typing import Annotated, Any, Final, NamedTuple

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

import truejoint


class Command(NamedTuple):
    """A command as a line in the list of commands."""

    place: str  # module and function of this package
    summary: str
    example: str  # its arguments


PANELS: Final[dict[str, dict[str, Command]]] = {
    "Start": {
        "demo": Command(
            "demo:demo", "Show the whole way on a simulated RAVEN-II, from homing to report.",
            "--out demo",
        ),
        "show": Command(
            "show:show", "Describe a model file or a recording.", "left_arm.safetensors"
        ),
    },
    "Data": {
        "collect": Command(
            "collect:collect", "Drive an arm along trajectories and record each.",
            "zigzag.csv random.csv --out session",
        ),
        "trajectory": Command(
            "trajectory:trajectory", "Make a trajectory, or describe one.",
            "random --minutes 20 --seed 7 -o random.csv",
        ),
        "columns": Command(
            "columns:columns", "Write a column map to start from for your file.",
            "run.csv --robot raven2 -o map.toml",
        ),
        "extract": Command(
            "extract:extract", "Make one recording of the bags or files of a session.",
            "state.bag encoders.bag --robot raven2 -o session.parquet",
        ),
        "doctor": Command(
            "doctor:doctor", "Check a recording, its bags, or a running ROS.",
            "session.bag --robot raven2",
        ),
        "datasets": Command("datasets:datasets", "List public recordings of real joints.", ""),
        "datasets fetch": Command(
            "datasets:fetch", "Fetch a data set and check the hash of every file.",
            "dvrk_psm_berkeley",
        ),
    },
    "Calibrate and judge": {
        "calibrate": Command(
            "calibrate:calibrate", "Fit a calibration to recordings with truth.",
            "session/zigzag.parquet -e dnn -o left_arm.safetensors",
        ),
        "adapt": Command(
            "adapt:adapt", "Adapt a calibration to a new day, tool, arm or load.",
            "left_arm.safetensors minute.parquet -o today.safetensors",
        ),
        "evaluate": Command(
            "evaluate:evaluate", "Judge a calibration on recordings that it never saw.",
            "left_arm.safetensors session/random.parquet --report report.html "
            "--tolerance elbow=0.2",
        ),
        "compare": Command(
            "compare:compare", "Compare several calibrations on the same recordings.",
            "linear.safetensors network.safetensors session/random.parquet",
        ),
        "correct": Command(
            "correct:correct", "Correct recordings as the robot's loop would.",
            "left_arm.safetensors session/random.parquet -o corrected.csv",
        ),
        "check": Command(
            "check:check", "Check with a brief truth whether a calibration still holds.",
            "left_arm.safetensors ten_seconds.parquet",
        ),
        "rezero": Command(
            "rezero:rezero", "Re-zero a calibration by truth, by touches or by its motors.",
            "left_arm.safetensors ten_seconds.parquet -o today.safetensors",
        ),
    },
    "Touch": {
        "touch block": Command(
            "block:block", "Design a block with dimples to print and touch.", "raven2 -o block"
        ),
        "touch run": Command(
            "touch:run", "Take an arm's tip into the dimples that tell most.",
            "left_arm.safetensors --bolted pose.toml -o today.csv",
        ),
        "touch bolt": Command(
            "bolt:bolt", "Find where a bolted block stands.",
            "left_arm.safetensors --touches touches.csv --block block.toml -o pose.toml",
        ),
        "touch calibrate": Command(
            "touch_calibrate:calibrate", "Calibrate an arm without joint sensors.",
            "session.parquet --touches touches.csv --block block.toml -o left_arm.safetensors",
        ),
    },
    "Robot": {
        "teleop": Command(
            "teleop:teleop", "Move an arm by keys.",
            "--robot raven2 --record session/by_hand.parquet",
        ),
        "monitor": Command(
            "monitor:monitor", "Watch an arm or a recording in the browser.",
            "session/random.parquet --model left_arm.safetensors",
        ),
        "node correct": Command(
            "node:correct", "Correct an arm's joints on the topics of a running ROS.",
            "left_arm.safetensors --profile raven2_mended",
        ),
        "node simulate": Command(
            "node:simulate", "Serve a digital twin on the topics of a running ROS.",
            "--robot raven2 --homed",
        ),
        "node record": Command(
            "node:record", "Record what an arm reports on the topics of a running ROS.",
            "left.parquet --profile raven2 --seconds 600",
        ),
        "export": Command(
            "export:export", "Write a calibration as C99, ONNX or a ROS package.",
            "left_arm.safetensors --to c --out controller",
        ),
    },
    "Papers": {
        "study": Command(
            "study:study", "Repeat an experiment of the papers, or one of ours.",
            "forceps-unloaded --set specimen=B",
        ),
    },
}  # fmt: skip
COMMANDS: Final = {name: c for panel in PANELS.values() for name, c in panel.items()}
GROUPS: Final = {
    "datasets": "List and fetch public recordings of real joints.",
    "touch": "Calibrate and re-zero by touching a printed block (docs/touch.md).",
    "node": "Correct, simulate or record an arm on the topics of a running ROS (docs/ros.md).",
}
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
            panel = next(p for p, c in PANELS.items() if any(f"{n} ".startswith(f"{name} ")
                                                             for n in c))  # fmt: skip
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
        commands, self.commands = self.commands, self.commands.listed()  # type: ignore[attr-defined]
        try:
            super().format_help(ctx, formatter)
        finally:
            self.commands = commands


def _example(name: str) -> str:
    return f"Example: `truejoint {name} {COMMANDS[name].example}`"


@cache
def _command(name: str) -> Any:
    app = typer.Typer(add_completion=False, **_HOW)
    module, _, function = COMMANDS[name].place.partition(":")
    word = name.rsplit(maxsplit=1)[-1]
    app.command(word, epilog=_example(name))(
        getattr(import_module(f"truejoint.cli.{module}"), function)
    )
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
    place = COMMANDS[name].place.partition(":") if is_command else None
    app.callback()(
        getattr(import_module(f"truejoint.cli.{place[0]}"), place[2]) if place else _nothing
    )
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
