"""`truejoint doctor`: what ails a recording, or the link that brought it, a verdict for each."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import truejoint
from truejoint.cli import complete, options
from truejoint.cli.bags import Profile
from truejoint.cli.console import out, progress, result_json
from truejoint.cli.data import CHECK_FAILED
from truejoint.errors import RecordingError

_COLOURS = {"good": "green", "info": "", "warn": "yellow", "fail": "red"}


def doctor(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="BAG...|RECORDING",
            help="All bags of one session, or one recording.",
            autocompletion=complete.recordings,
        ),
    ],
    robot: options.FilesRobot = None,
    arm: options.FilesArm = "",
    profile: Profile = "",
    state: Annotated[str, typer.Option(help="Topic of the measured joints; default: found.")] = "",
    truth: Annotated[str, typer.Option(help="Topic of joint sensors; default: found.")] = "",
    as_json: options.Json = False,
) -> None:
    """Say what ails a recording or its link; exit code 1 when a verdict is `fail`."""
    sets = truejoint.recordings
    is_bag = len(files) > 1 or sets.detect_format(files[0]) == "bag"
    with progress(f"Examining {', '.join(path.name for path in files)}"):
        if is_bag:
            recording = sets.read_bag(
                files, robot or "", arm, profile=profile, state=state, truth=truth
            )
            diagnosis = sets.diagnose(recording, sets.read_other_arm(files, recording))
        elif profile or state or truth:
            raise RecordingError(f"{files[0]}: is no bag, so it has neither profile nor topics")
        else:
            told = {"robot": robot, "arm": arm or None}
            given = {key: value for key, value in told.items() if value is not None}
            diagnosis = sets.diagnose(truejoint.read_recording(files[0], **given))
    if as_json:
        result_json(diagnosis.to_dict())
    for verdict in () if as_json else diagnosis.verdicts:
        advice = f"; {verdict.advice}" if verdict.advice else ""
        line = f"{verdict.level:4} {verdict.name}: {verdict.evidence}{advice}"
        out.print(line, style=_COLOURS[verdict.level], soft_wrap=True)
    if diagnosis.failed:
        raise typer.Exit(CHECK_FAILED)
