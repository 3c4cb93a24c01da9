"""`truejoint extract` and `bag`: recordings out of ROS bags, and bags of recordings."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

import truejoint
from truejoint.cli import complete, options
from truejoint.cli.console import command_line, out, progress, result_json
from truejoint.cli.inputs import Files, check_offset, say_dropped, takes_files
from truejoint.cli.track import Registration, show, with_tracked_truth
from truejoint.errors import RecordingError
from truejoint.files import check_target

Profile = Annotated[
    str,
    typer.Option(
        "--profile",
        help="How the robot's messages differ from CRTK; default: the robot's own.",
        autocompletion=complete.message_profiles,
    ),
]


def extract(
    bags: Annotated[
        list[Path],
        typer.Argument(
            metavar="BAG...", help="All bags of one session: .bag, .mcap, .db3, folder."
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Recording to write, .parquet; default: list the topics."),
    ] = None,
    profile: Profile = "",
    state: Annotated[
        str, typer.Option("--state", help="Topic of the measured joints; default: found.")
    ] = "",
    truth: Annotated[
        str,
        typer.Option(
            "--truth",
            help="Topic of joint sensors, or a file of theirs; default: found in the bags.",
        ),
    ] = "",
    tracker: Annotated[
        str,
        typer.Option(
            help="Topic of a tracker or camera that saw the tool, in place of joint sensors; "
            "default with --registration: found by type."
        ),
    ] = "",
    registration: Registration = None,
    truth_columns: Annotated[
        Path | None, typer.Option(help="TOML file that names the columns of a truth file.")
    ] = None,
    quantity: Annotated[
        list[str] | None,
        typer.Option(
            help="More of RAVEN's state, for instance motor; once for each.",
            autocompletion=lambda: [*truejoint.crtk.messages.RAVEN_FIELDS],
        ),
    ] = None,
    near_s: options.NearS = None,
    offset_s: Annotated[
        float | None,
        typer.Option(help="What to add to the stamps of the truth [s]; default: see docs/bags.md."),
    ] = None,
    robot: options.FilesRobot = None,
    arm: options.FilesArm = "",
    homing_id: options.HomingId = None,
    load_grams: options.LoadGrams = None,
    session: options.Session = None,
    force: options.Force = False,
    as_json: options.Json = False,
) -> None:
    """Make a recording of the bags of a session, or list their topics."""
    if output is None:
        of_recording = (
            profile, state, truth, tracker, registration, truth_columns, quantity, near_s,
            offset_s, robot, arm, homing_id, load_grams, session, force or None,
        )  # fmt: skip
        if any(option not in (None, "", []) for option in of_recording):
            raise RecordingError("no --out, so the topics are listed, which takes --json alone")
        _list_topics(bags, as_json=as_json)
        return
    check_offset(near_s, offset_s)
    check_target(output, overwrite=force)
    by_file, tracked = bool(truth) and Path(truth).exists(), bool(tracker or registration)
    if truth_columns is not None and not by_file:
        raise RecordingError("--truth-columns is for a file of the truth; name it with --truth")
    if truth and tracked:
        raise RecordingError("--truth and a tracker both tell where the joints are; give one")
    with progress(f"Reading {len(bags)} bag{'s'[: len(bags) != 1]}"):
        seen = truejoint.recordings.read_track(bags, tracker) if tracked else None
        recording = truejoint.recordings.read_bag(
            bags,
            robot or "",
            arm,
            profile=profile,
            state=state,
            truth=None if by_file or tracked else truth,
            quantities=(*truejoint.crtk.messages.USUAL_QUANTITIES, *(quantity or ())),
            offset=offset_s,
            near=near_s,
        )
    registered = None
    if seen is not None:
        recording, registered = with_tracked_truth(
            recording, seen, registration, offset=offset_s, near=near_s
        )
    elif by_file:
        machine = recording.robot
        stream = truejoint.recordings.read_truth(truth, machine.name, machine.arm, truth_columns)
        recording, _ = truejoint.recordings.join_truth(recording, stream, offset_s, near=near_s)
    stated: dict[str, Any] = {"homing_id": homing_id, "session": session}
    stated["load"] = None if load_grams is None else load_grams / 1000.0
    known = {key: value for key, value in stated.items() if value is not None}
    provenance = replace(recording.provenance, command=command_line(), **known)
    recording = replace(recording, provenance=provenance)
    truejoint.write_parquet(recording, output, overwrite=force)
    say_dropped(recording)
    _tell(recording, output, registered, as_json=as_json)


def _list_topics(bags: list[Path], *, as_json: bool) -> None:
    topics = truejoint.recordings.bag_topics(bags)
    if as_json:
        result_json({n: {"type": kind, "messages": c} for n, (kind, c) in topics.items()})
        return
    for name, (kind, count) in sorted(topics.items()):
        out.print(f"{name}  {kind}  {count}", soft_wrap=True)


def _tell(
    recording: truejoint.Recording,
    output: Path,
    registered: truejoint.calibration.Registered | None,
    *,
    as_json: bool,
) -> None:
    if as_json:
        told = {
            "recording": str(output),
            "rows": len(recording),
            **recording.provenance.to_dict(),
            **({"tracker": registered.to_dict()} if registered else {}),
        }
        result_json(told)
        return
    if registered is not None:
        show(registered)
    found = ", ".join(recording.joints_of("truth")) or "none"
    out.print(f"{output}: {len(recording)} rows over {recording.duration:.1f} s, truth of {found}")


@takes_files
def bag(
    recording: Annotated[
        str, typer.Argument(help="Recording to write as a bag.", autocompletion=complete.recordings)
    ],
    output: Annotated[
        Path, typer.Option("--out", "-o", help="File to write: .bag for ROS 1, .mcap for ROS 2.")
    ],
    profile: Profile = "",
    force: options.Force = False,
    *,
    files: Files,
) -> None:
    """Write a recording as a ROS bag of CRTK's topics, for other tools."""
    check_target(output, overwrite=force)
    found = files.one(recording)
    with progress(f"Writing {output}"):
        truejoint.recordings.write_bag(found, output, profile=profile, overwrite=force)
    topics = ", ".join(truejoint.recordings.bag_topics(output))
    out.print(f"{output}: {len(found)} rows as {topics}")
