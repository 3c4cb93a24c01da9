"""The commands of `truejoint`, each with an example."""

from __future__ import annotations

from functools import cache
from typing import Annotated, Any

import typer
from typer.main import get_command

import truejoint
from truejoint.cli import (
    bags,
    calibrate,
    check,
    collect,
    columns,
    compare,
    correct,
    datasets,
    demo,
    doctor,
    evaluate,
    export,
    forceps,
    join,
    monitor,
    node,
    plate,
    rezero,
    show,
    study,
    teleop,
    touch,
    track,
    trajectory,
)

app = typer.Typer(
    name="truejoint",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Tell where a cable-driven joint really is: calibrate, correct, and judge the error.",
    epilog="Example: `truejoint demo` shows the whole way on a simulated RAVEN-II.",
)
for command, example in (
    (demo.demo, "--out demo"),
    (collect.collect, "zigzag.csv random.csv --out session"),
    (calibrate.calibrate, "session/zigzag.parquet -e dnn -o left_arm.safetensors"),
    (
        evaluate.evaluate,
        "left_arm.safetensors session/random.parquet --report report.html --tolerance elbow=0.2",
    ),
    (compare.compare, "linear.safetensors network.safetensors session/random.parquet"),
    (correct.correct, "left_arm.safetensors session/random.parquet -o corrected.csv"),
    (columns.columns, "run.csv --robot raven2 -o map.toml"),
    (join.join, "robot.csv encoders.csv --robot raven2 -o session.parquet"),
    (track.track, "robot.parquet points.csv --registration tracker.toml -o session.parquet"),
    (bags.extract, "state.bag encoders.bag --robot raven2 -o session.parquet"),
    (bags.bag, "session.parquet -o session.bag"),
    (doctor.doctor, "session.bag --robot raven2"),
    (show.show, "left_arm.safetensors"),
    (check.check, "left_arm.safetensors ten_seconds.parquet --rezero today.safetensors"),
    (plate.plate, "raven2 -o block"),
    (
        rezero.bolt,
        "left_arm.safetensors --touches touches.csv --plate plate.toml -o pose.toml",
    ),
    (touch.touch, "left_arm.safetensors --bolted pose.toml -o today.csv"),
    (
        rezero.rezero,
        "left_arm.safetensors --touches touches.csv --bolted pose.toml -o today.safetensors",
    ),
    (export.export, "left_arm.safetensors --to c --out controller"),
    (teleop.teleop, "--robot raven2 --record session/by_hand.parquet"),
    (monitor.monitor, "session/random.parquet --model left_arm.safetensors"),
    (study.study, "forceps-unloaded --set specimen=B"),
):
    app.command(epilog=f"Example: `truejoint {command.__name__} {example}`")(command)
for group, example in (
    (trajectory, "trajectory random --minutes 20 --seed 7 -o random.csv"),
    (datasets, "datasets fetch dvrk_psm_berkeley"),
    (node, "node correct left_arm.safetensors"),
    (forceps, "forceps zero jaw.safetensors cycle.parquet -o today.safetensors"),
):
    app.add_typer(
        group.app,
        name=group.__name__.rpartition(".")[2],
        epilog=f"Example: `truejoint {example}`",
    )


def _print_version(wanted: bool) -> None:
    if wanted:
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
    """Command that parses a line and does what it says; building it takes a tenth of a second."""
    return get_command(app)
