"""`truejoint join`: the robot's file and that of its joint sensors become one recording."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

import truejoint
from truejoint.cli import options
from truejoint.cli.console import out, progress, result_json
from truejoint.cli.inputs import Clocks, Files, say_dropped, takes
from truejoint.errors import RecordingError
from truejoint.files import check_ending, check_target


@takes(files=Files, clocks=Clocks)
def join(
    robot_file: options.RobotFile,
    truth_file: Annotated[
        Path,
        typer.Argument(metavar="TRUTH", help="File with t and `truth/<joint>`, or any with a map."),
    ],
    output: options.OutRecording,
    truth_columns: Annotated[
        Path | None,
        typer.Option(help="TOML file that names the columns of TRUTH; see `truejoint columns`."),
    ] = None,
    *,
    clocks: Clocks,
    force: options.Force = False,
    as_json: options.Json = False,
    files: Files,
) -> None:
    """Join a robot's recording with the truth that was recorded in a file of its own."""
    check_ending(output, ".parquet", "a recording", RecordingError)
    check_target(output, overwrite=force)
    found = files.one(robot_file)
    arm = found.robot
    truth = truejoint.recordings.read_truth(truth_file, arm.name, arm.arm, truth_columns)
    with progress("Finding the offset of the clocks"):
        recording, clock = truejoint.recordings.join_truth(
            found, truth, clocks.offset_s, near=clocks.near_s
        )
    truejoint.write_parquet(recording, output, overwrite=force)
    say_dropped(recording)
    known = int(
        recording.table[[f"truth/{joint}" for joint in recording.joints_of("truth")]]
        .notna()
        .all(axis=1)
        .sum()
    )
    if as_json:
        offset = {k: v for k, v in asdict(clock).items() if clock.joints or k == "seconds"}
        result_json({"recording": str(output), "offset": offset, "rows_with_truth": known})
        return
    how = f"± {clock.sd:.2g} s, by the motion of {', '.join(clock.joints)}"
    out.print(
        f"{output}: {known} of {len(recording)} rows with truth, whose clock is "
        f"{clock} behind ({how if clock.joints else 'as stated'})"
    )
