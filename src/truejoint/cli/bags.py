"""`truejoint extract` and `bag`: recordings out of ROS bags, and bags of recordings."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import typer

import truejoint
from truejoint.cli import complete, options
from truejoint.cli.console import command_line, out, progress, result_json
from truejoint.cli.inputs import Clocks, Files, Origin, say_dropped, takes, takes_files
from truejoint.cli.track import Registration, show, with_tracked_truth
from truejoint.errors import RecordingError
from truejoint.files import check_ending, check_target

Profile = Annotated[
    str,
    typer.Option(
        "--profile",
        help="How the robot's messages differ from CRTK; default: the robot's own.",
        autocompletion=complete.message_profiles,
    ),
]


@dataclass(frozen=True)
class Truth:
    """Where the truth of a session's bags is from, an option each."""

    truth: Annotated[
        str,
        typer.Option(
            help="Topic of joint sensors, or a file of theirs; default: found in the bags."
        ),
    ] = ""
    truth_columns: Annotated[
        Path | None, typer.Option(help="TOML file that names the columns of a truth file.")
    ] = None
    tracker: Annotated[
        str,
        typer.Option(
            help="Topic of a tracker or camera that saw the tool, in place of joint sensors; "
            "default with --registration: found by type."
        ),
    ] = ""
    registration: Registration = None

    def __post_init__(self) -> None:
        if self.truth_columns is not None and not self.is_file:
            raise RecordingError("--truth-columns is for a file of the truth; name it with --truth")
        if self.truth and self.is_tracked:
            raise RecordingError("--truth and a tracker both tell where the joints are; give one")

    @property
    def is_file(self) -> bool:
        """Whether it is in a file of its own."""
        return bool(self.truth) and Path(self.truth).exists()

    @property
    def is_tracked(self) -> bool:
        """Whether a tracker tells it."""
        return bool(self.tracker or self.registration)

    @property
    def topic(self) -> str | None:
        """Topic of joint sensors, empty where it is to be found, None where there is none."""
        return None if self.is_file or self.is_tracked else self.truth

    def joined(
        self,
        recording: truejoint.Recording,
        seen: truejoint.recordings.Track | None,
        clocks: Clocks,
    ) -> tuple[truejoint.Recording, truejoint.tip.Registered | None]:
        """Give a recording the truth of a file, or of what a tracker has `seen`, if any."""
        if seen is not None:
            return with_tracked_truth(recording, seen, self.registration, clocks)
        if self.is_file:
            machine, sets = recording.robot, truejoint.recordings
            stream = sets.read_truth(self.truth, machine.name, machine.arm, self.truth_columns)
            recording, _ = sets.join_truth(recording, stream, clocks.offset_s, near=clocks.near_s)
        return recording, None


@takes(truth=Truth, clocks=Clocks, origin=Origin)
def extract(
    bags: Annotated[
        list[Path],
        typer.Argument(metavar="BAG", help="All bags of one session: .bag, .mcap, .db3, folder."),
    ],
    output: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Recording to write, .parquet; default: list the topics."),
    ] = None,
    *,
    profile: Profile = "",
    state: Annotated[
        str, typer.Option("--state", help="Topic of the measured joints; default: found.")
    ] = "",
    truth: Truth,
    quantity: Annotated[
        list[str] | None,
        typer.Option(
            help="More of RAVEN's state, for instance motor; once for each.",
            autocompletion=lambda: [*truejoint.crtk.messages.RAVEN_FIELDS],
        ),
    ] = None,
    clocks: Clocks,
    origin: Origin,
    force: options.Force = False,
    as_json: options.Json = False,
) -> None:
    """Make a recording of the bags of a session, or list their topics."""
    if output is None:
        if (truth, clocks, origin) != (Truth(), Clocks(), Origin()) or any(
            (profile, state, quantity, force)
        ):
            raise RecordingError("no --out, so the topics are listed, which takes --json alone")
        _list_topics(bags, as_json=as_json)
        return
    check_ending(output, ".parquet", "a recording", RecordingError)
    check_target(output, overwrite=force)
    with progress(f"Reading {len(bags)} bag{'s'[: len(bags) != 1]}"):
        seen = truejoint.recordings.read_track(bags, truth.tracker) if truth.is_tracked else None
        recording = truejoint.recordings.read_bag(
            bags,
            origin.robot or "",
            origin.arm,
            profile=profile,
            state=state,
            truth=truth.topic,
            quantities=(*truejoint.crtk.messages.USUAL_QUANTITIES, *(quantity or ())),
            offset=clocks.offset_s,
            near=clocks.near_s,
        )
    recording, registered = truth.joined(recording, seen, clocks)
    provenance = replace(recording.provenance, command=command_line(), **origin.stated())
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
    registered: truejoint.tip.Registered | None,
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
        str,
        typer.Argument(
            metavar="RECORDING",
            help="Recording to write as a bag.",
            autocompletion=complete.recordings,
        ),
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
