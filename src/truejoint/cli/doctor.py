"""`truejoint doctor`: what is wrong with a recording, or with the link that brings it."""

import time
from pathlib import Path
from typing import Final

import truejoint
from truejoint.cli.console import out, progress, say
from truejoint.cli.node import as_node, wait
from truejoint.cli.options import Result, robot_and_arm
from truejoint.cli.recording_options import Files
from truejoint.errors import RecordingError

_COLOURS = {"good": "green", "info": "", "warn": "yellow", "fail": "red"}
_LIVE: Final = "live"
_DURATION_S: Final = 10.0


def doctor(
    files: list[Path],
    robot: str | None = None,
    columns: Path | None = None,
    profile: str = "",
    state: str = "",
    truth: str = "",
    duration_s: float | None = None,
    ros: int | None = None,
) -> Result:
    """Say what is wrong with a recording or its link; exit code 1 when a verdict is `fail`."""
    from truejoint.recordings.read.track import read_tool_poses

    sets = truejoint.recordings
    name, arm = robot_and_arm(robot or "")
    wiring = {"profile": profile, "state": state, "truth": truth}
    if files == [Path(_LIVE)] and not (columns or files[0].exists()):
        diagnosis = _listen(name, arm, wiring, duration_s or _DURATION_S, ros or 1)
    elif duration_s is not None or ros is not None:
        raise RecordingError("--duration-s and --ros are for `truejoint doctor live`")
    elif len(files) > 1 or (columns is None and sets.detect_format(files[0]) == "bag"):
        with progress(f"Examining {', '.join(path.name for path in files)}"):
            recording = sets.read_bag(files, name, arm, profile=profile, state=state, truth=truth)
            poses = read_tool_poses(files, recording, profile, state)
            diagnosis = sets.diagnose(recording, sets.read_other_arm(files, recording), poses)
    elif any(wiring.values()):
        raise RecordingError(f"{files[0]}: is no bag, so it has neither profile nor topics")
    else:
        recording = Files(robot, columns=columns).one(str(files[0]))
        with progress(f"Examining {files[0].name}"):
            diagnosis = sets.diagnose(recording)
    for finding in diagnosis.by_heading():
        advice = f"; {finding.advice}" if finding.advice else ""
        line = f"{finding.level:4} {finding.heading}: {finding.text}{advice}"
        out.print(line, style=_COLOURS[finding.level], soft_wrap=True)
    return Result(diagnosis.to_dict(), passed=not diagnosis.failed)


def _listen(
    robot: str, arm: str, wiring: dict[str, str], duration_s: float, ros: int
) -> "truejoint.recordings.DataCheck":
    """Judge what is said on an arm's topics for some seconds, or until Ctrl-C."""
    from truejoint.recordings.judge.live import LiveLink

    with as_node("truejoint_doctor", ros) as transport:
        link = LiveLink(transport, robot, arm, **wiring)
        with link, progress(f"Listening for {duration_s:g} s") as done:
            began = time.monotonic()
            try:
                wait(transport, duration_s, lambda: done((time.monotonic() - began) / duration_s))
            except KeyboardInterrupt:
                say(f"stopped after {time.monotonic() - began:.1f} s; of these:")
        return link.diagnose()
    raise KeyboardInterrupt  # which ended the node before there was anything to judge
