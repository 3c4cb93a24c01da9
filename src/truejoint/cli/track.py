"""`truejoint track`: points or poses of a tracker become the truth of the joints."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Final

import typer

import truejoint
from truejoint.cli import options
from truejoint.cli.console import out, progress, result_json, say
from truejoint.cli.inputs import Clocks, Files, say_dropped, takes
from truejoint.errors import RecordingError
from truejoint.files import check_ending, check_target

Registration = Annotated[
    Path | None,
    typer.Option(help="TOML file of what is known of the tracker; see docs/tracker.md."),
]

_MANY: Final = 0.05  # strays, as a share of the readings


@takes(files=Files, clocks=Clocks)
def track(
    robot_file: options.RobotFile,
    points: Annotated[
        Path,
        typer.Argument(
            metavar="POINTS",
            help="CSV or Parquet with t, x, y, z[, qx, qy, qz, qw], or a bag.",
        ),
    ],
    output: options.OutRecording,
    topic: Annotated[
        str, typer.Option(help="Topic of the tracker in a bag; default: the only one.")
    ] = "",
    unit: Annotated[str, typer.Option(help="Of the points in a file: m, cm, mm or um.")] = "m",
    registration: Registration = None,
    joint: Annotated[
        list[str] | None,
        typer.Option(help="Joint to be found, once for each; default: those that place the tool."),
    ] = None,
    *,
    clocks: Clocks,
    force: options.Force = False,
    as_json: options.Json = False,
    files: Files,
) -> None:
    """Turn what a tracker or a camera saw of the tool into the truth of the joints."""
    check_ending(output, ".parquet", "a recording", RecordingError)
    check_target(output, overwrite=force)
    seen = truejoint.recordings.read_track(points, topic, unit)
    recording, registered = with_tracked_truth(
        files.one(robot_file), seen, registration, clocks, joint or ()
    )
    truejoint.write_parquet(recording, output, overwrite=force)
    say_dropped(recording)
    if as_json:
        result_json({"recording": str(output), **registered.to_dict()})
        return
    show(registered)
    out.print(f"{output}: {len(recording)} rows, truth of {', '.join(registered.joints)}")


def with_tracked_truth(
    recording: truejoint.Recording,
    seen: truejoint.recordings.Track,
    registration: Path | None,
    clocks: Clocks,
    joints: Sequence[str] = (),
) -> tuple[truejoint.Recording, truejoint.tip.Registered]:
    """Give a recording the truth that a tracker saw, and say what was left out of its readings."""
    known = None
    if registration is not None:
        known = truejoint.tip.read_registration(registration, recording.robot)
    with progress("Finding where the tracker stands, and what it says of the joints"):
        found, registered = truejoint.tip.tracked_truth(
            recording, seen, known, joints, offset=clocks.offset_s, near=clocks.near_s
        )
    for stretch in registered.stretches:
        say(f"warn: left out, {stretch}")
    share = registered.strays / (registered.strays + registered.readings)
    if share > _MANY:
        say(
            f"warn: {100 * share:.0f} % of the readings, one here and one there, fit no place of "
            "the marker and were left out; is its view clear?"
        )
    return found, registered


def show(registered: truejoint.tip.Registered) -> None:
    """Print where the tracker stands, and how sure that is."""
    for label, text in registered.summary().items():
        out.print(f"{label:12} {text}")
