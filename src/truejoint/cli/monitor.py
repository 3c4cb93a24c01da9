"""`truejoint monitor`: watch an arm or a recording in the browser."""

from __future__ import annotations

import itertools
import threading
from contextlib import ExitStack
from pathlib import Path

import truejoint
from truejoint.cli.console import out, say
from truejoint.cli.recording_options import Files, read_trajectory
from truejoint.errors import TruejointError
from truejoint.robots.catalogue import DEFAULT

_PIECE = 600.0  # of random motion [s]
_DAY = 86400.0  # for which a pause may last [s]


def monitor(
    files: Files,
    recording: str | None = None,
    model: Path | None = None,
    follow: Path | None = None,
    twin: str | None = None,
    seed: int | None = None,
    host: str = "127.0.0.1",
    port: int = 8080,
) -> None:
    """Show an arm in the browser: reported, corrected and true pose, plots, statuses.

    The page is on this computer alone. A simulated arm homes and moves in real time until Ctrl-C;
    the page's buttons pause and resume it.
    """
    calibration = None if model is None else truejoint.read_calibration(model)
    try:
        if recording is not None:
            if follow is not None or twin is not None or seed is not None:
                raise TruejointError("--follow, --twin and --seed are for a simulated arm")
            shown = files.one(recording, model=calibration)
            with truejoint.monitor.RecordingPage(shown, calibration, host=host, port=port) as page:
                out.print(f"Open {page.url} in a browser; Ctrl-C ends.")
                _wait()
        else:
            if files != Files(robot=files.robot):
                raise TruejointError("--columns and --metadata need a recording")
            motions = None if follow is None else [read_trajectory(follow)]
            made = truejoint.simulation.make_twin(
                files.arm[0] or DEFAULT, files.arm[1], parameters=twin or "nominal", seed=seed or 0
            )
            _show_arm(made, motions, calibration, host, port)
    except KeyboardInterrupt:
        say("stopped")


def _show_arm(
    twin: truejoint.simulation.Twin,
    motions: list[truejoint.motion.Trajectory] | None,
    calibration: truejoint.Calibration | None,
    host: str,
    port: int,
) -> None:
    """Home and move a simulated arm with the page beside it, until Ctrl-C."""
    with ExitStack() as stack:
        arm = stack.enter_context(truejoint.crtk.Arm(truejoint.crtk.PacedBackend(twin)))
        page = truejoint.monitor.ArmPage(arm, calibration, host=host, port=port)
        stack.enter_context(page)
        out.print(f"Open {page.url} in a browser; Ctrl-C ends.")
        say(f"Homing {arm.robot.title}, simulated in real time ...")
        try:
            arm.enable()
            arm.home()
            endless = (
                truejoint.motion.random_motion(arm.robot, _PIECE, seed)
                for seed in itertools.count()
            )
            for motion in motions or endless:
                truejoint.motion.follow(arm, motion, resume_within=_DAY)
        except TruejointError as error:
            say(str(error))  # the page shows where it stands
        _wait()


def _wait() -> None:
    threading.Event().wait()
