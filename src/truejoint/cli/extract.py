"""`truejoint extract` and `columns`: recordings of bags, and of files with others' columns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import truejoint
from truejoint.cli.console import command_line, out, progress, say
from truejoint.cli.options import Result, robot_and_arm
from truejoint.cli.recording_options import Files, say_dropped
from truejoint.errors import RecordingError, printable
from truejoint.files import check_ending, check_target, write_atomically
from truejoint.units import plural

_MANY: Final = 0.05  # stray readings, as a share of all


@dataclass(frozen=True)
class Truth:
    """Source of the truth, an option each."""

    truth: str = ""
    truth_columns: Path | None = None
    tracker: str = ""
    registration: Path | None = None
    unit: str = "m"
    joint: list[str] | None = None
    near_s: float | None = None
    offset_s: float | None = None

    def __post_init__(self) -> None:
        if self.truth_columns is not None and not self.is_file:
            raise RecordingError("--truth-columns needs --truth FILE, the file that it maps")

    @property
    def is_file(self) -> bool:
        """Whether joint sensors are in a file of their own."""
        return bool(self.truth) and Path(self.truth).exists()

    @property
    def is_tracked(self) -> bool:
        """Whether a tracker gives the truth."""
        return bool(self.tracker or self.registration)

    @property
    def topic(self) -> str | None:
        """Topic of joint sensors, empty where it is to be found, None where there is none."""
        return None if self.is_file or self.is_tracked else self.truth

    def track(self, bags: Sequence[Path]) -> truejoint.recordings.Track | None:
        """Read what the tracker saw, of its file or of the bags; None where there is none."""
        if not self.is_tracked:
            return None
        if self.tracker and Path(self.tracker).exists():
            return truejoint.recordings.read_track(Path(self.tracker), "", self.unit)
        if not bags:
            raise RecordingError(
                f"--tracker {self.tracker!r:.60}: no such file, and no bag has such a topic"
            )
        return truejoint.recordings.read_track(bags, self.tracker)

    def joined(
        self, recording: truejoint.Recording, track: truejoint.recordings.Track | None
    ) -> tuple[truejoint.Recording, dict[str, Any]]:
        """Give a recording its truth, and say how; with that as values."""
        if track is not None:
            return self._with_tracked_truth(recording, track)
        if not self.is_file:
            return recording, {}
        stream = truejoint.recordings.read_truth(
            self.truth, recording.robot, column_map=self.truth_columns
        )
        with progress("Estimating the offset of the clocks"):
            recording, clock = truejoint.recordings.join_truth(
                recording, stream, self.offset_s, near=self.near_s
            )
        offset: dict[str, Any] = {"seconds": clock.seconds}
        how = "as stated"
        if clock.joints:
            offset |= {"sd": clock.sd, "joints": list(clock.joints)}
            how = f"± {clock.sd:.2g} s, by the motion of {', '.join(clock.joints)}"
        out.print(f"The clock of the truth is {clock} behind ({how})", soft_wrap=True)
        return recording, {"offset": offset}

    def _with_tracked_truth(
        self, recording: truejoint.Recording, track: truejoint.recordings.Track
    ) -> tuple[truejoint.Recording, dict[str, Any]]:
        stated = None
        if self.registration is not None:
            stated = truejoint.tip.read_registration(self.registration)
        with progress("Registering the tracker and solving for the joints"):
            recording, registered = truejoint.tip.tracked_truth(
                recording, track, stated, self.joint or (), offset=self.offset_s, near=self.near_s
            )
        for stretch in registered.stretches:
            say(f"warn: left out, {stretch}")
        share = registered.strays / (registered.strays + registered.readings)
        if share > _MANY:
            say(
                f"warn: {100 * share:.0f} % of the readings fit no place of the marker and were "
                "left out; is its view clear?"
            )
        for label, text in registered.summary().items():
            out.print(f"{label:12} {text}", soft_wrap=True)
        return recording, {"tracker": registered}


def extract(
    names: list[Path],
    truth: Truth,
    files: Files,
    output: Path | None = None,
    profile: str = "",
    state: str = "",
    quantity: list[str] | None = None,
    force: bool = False,
) -> Result:
    """Make one recording of the bags or files of a session, or list the topics of bags.

    The truth comes from a topic of the bags, from a file of joint sensors (--truth), or from a
    tracker that saw the tool (--tracker, --registration).
    """
    from truejoint.crtk.messages import USUAL_QUANTITIES

    recordings = truejoint.recordings
    if output is None:
        if (truth, files) != (Truth(), Files()) or any((profile, state, quantity, force)):
            raise RecordingError("without --out the topics are listed, which takes --json alone")
        topics = recordings.bag_topics(names)
        for name, (type_, count) in sorted(topics.items()):
            out.print(f"{name}  {type_}  {count}", soft_wrap=True)
        return Result({n: {"type": t, "messages": c} for n, (t, c) in topics.items()})
    check_ending(output, ".parquet", "a recording", RecordingError)
    check_target(output, overwrite=force)
    kind = files.overrides.get("format")
    is_bag = files.columns is None and (kind or recordings.detect_format(names[0])) == "bag"
    if len(names) > 1 or is_bag:
        with progress(f"Reading {plural(len(names), 'bag')}"):
            track = truth.track(names)
            recording = recordings.read_bag(
                names, *files.arm, profile=profile, state=state,
                truth=truth.topic, quantities=(*USUAL_QUANTITIES, *(quantity or ())),
                offset=truth.offset_s, near=truth.near_s,
            )  # fmt: skip
    elif any((profile, state, quantity, truth.topic)):
        raise RecordingError(f"{names[0]}: is no bag, so it has neither a profile nor topics")
    else:
        track = truth.track([])
        recording = files.one(str(names[0]))
    recording, facts = truth.joined(recording, track)
    provenance = replace(recording.provenance, command=command_line(), **files.stated())
    recording = replace(recording, provenance=provenance)
    truejoint.write_parquet(recording, output, overwrite=force)
    say_dropped(recording)
    joints = recording.joints_of("truth")
    columns = [f"truth/{joint}" for joint in joints]
    rows_with_truth = int(recording.table[columns].notna().all(axis=1).sum()) if joints else 0
    out.print(
        f"{output}: {len(recording)} rows over {recording.duration:.1f} s, {rows_with_truth} with "
        f"truth of {', '.join(joints) or 'no joint'}"
    )
    counts = {"rows": len(recording), "rows_with_truth": rows_with_truth}
    return Result({"recording": str(output), **counts, **recording.provenance.to_dict(), **facts})


def columns(path: Path, robot: str = "", output: Path | None = None, force: bool = False) -> None:
    """Write a column map for a file, its columns guessed by their names, for you to edit.

    Other commands take it with `--columns`.
    """
    text = truejoint.recordings.sketch_column_map(path, *robot_and_arm(robot)) + "\n"
    if output is None:
        out.print(text, end="", soft_wrap=True)
    else:
        data = printable(text).encode()
        write_atomically(output, data, overwrite=force, error=RecordingError)
        out.print(f"{output}: mend it, then give it with --columns")
