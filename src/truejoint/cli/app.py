"""The `truejoint` command: parse, call, print.

Exit codes: 0 good, 1 a check failed, 2 the call was wrong.
"""

from __future__ import annotations

import sys
from importlib.metadata import version
from typing import Annotated

import typer

from truejoint.cli import (
    calibrate,
    check,
    collect,
    datasets,
    demo,
    evaluate,
    export,
    study,
    trajectory,
)
from truejoint.cli.console import err
from truejoint.errors import TruejointError

app = typer.Typer(
    name="truejoint",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Tell where a cable-driven joint really is: calibrate, correct, and judge the error.",
    epilog="Example: `truejoint demo` shows the whole way on a simulated RAVEN-II.",
)
app.command("demo", epilog="Example: `truejoint demo --out demo`")(demo.demo)
app.add_typer(trajectory.app, name="trajectory")
app.command("collect", epilog="Example: `truejoint collect zigzag.csv random.csv --out session`")(
    collect.collect
)
app.command(
    "calibrate",
    epilog="Example: `truejoint calibrate session/zigzag.parquet -e dnn -o left_arm.safetensors`",
)(calibrate.calibrate)
app.command(
    "evaluate",
    epilog="Example: `truejoint evaluate left_arm.safetensors session/random.parquet "
    "--report report.html --tolerance elbow=0.2`",
)(evaluate.evaluate)
app.command(
    "check",
    epilog="Example: `truejoint check left_arm.safetensors ten_seconds.parquet "
    "--rezero today.safetensors`",
)(check.check)
app.command(
    "export", epilog="Example: `truejoint export left_arm.safetensors --to c --out controller`"
)(export.export)
app.command("study", epilog="Example: `truejoint study forceps-unloaded --set specimen=B`")(
    study.study
)
app.add_typer(datasets.app, name="datasets")


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"truejoint {version('truejoint')}")
        raise typer.Exit


@app.callback()
def root(
    show_version: Annotated[
        bool,
        typer.Option("--version", callback=_print_version, is_eager=True, help="Show the version."),
    ] = False,
) -> None:
    """Tell where a cable-driven joint really is."""
    del show_version  # its callback has already answered


def main() -> None:
    """Run the command line; an error that the caller can mend is one line and exit code 2."""
    try:
        app()
    except TruejointError as error:
        _fail(str(error))
    except OSError as error:
        _fail(f"{error.filename or 'file'}: {error.strerror or error}; check path and permissions")


def _fail(message: str) -> None:
    err.print(f"truejoint: {message}", style="red", markup=False, highlight=False, soft_wrap=True)
    sys.exit(2)
