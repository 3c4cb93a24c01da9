"""`truejoint monitor`: watch an arm or a recording in the browser."""

from __future__ import annotations

import itertools
import threading
from contextlib import ExitStack
from pathlib import Path

import truejoint
from truejoint.cli import options
from truejoint.cli.console import out, say
from truejoint.cli.driven_arm import ArmOnTopics
from truejoint.cli.recording_options import Files, read_trajectory
from truejoint.errors import TruejointError
from truejoint.robots.catalogue import DEFAULT

_PIECE = 600.0  # of random motion [s]
_DAY = 86400.0  # for which a pause may last [s]


def monitor(
    files: Files,
    live: ArmOnTopics,
    recording: str | None = None,
    model: Path | None = None,
    follow: Path | None = None,
    twin: str | None = None,
    seed: int | None = None,
    host: str = "127.0.0.1",
    port: int = 8080,
    remote_control: bool = False,
) -> None:
    """Show an arm in the browser: reported, corrected and true pose, plots, statuses.

    The page is on this computer alone unless --host says otherwise. A simulated arm moves in real
    time until Ctrl-C. An arm over ROS gets no command but the page's: pause and resume.
    """
    calibration = None if model is None else truejoint.read_calibration(model)
    try:
        with ExitStack() as stack:
            page: truejoint.monitor.ArmPage | truejoint.monitor.RecordingPage
            if recording is not None:
                shown = files.one(recording, model=calibration)
                page = truejoint.monitor.RecordingPage(shown, calibration, host=host, port=port)
            else:
                if files != Files(robot=files.robot):
                    raise TruejointError("--columns and --metadata need a recording")
                motions = None if follow is None else [read_trajectory(follow)]
                name = files.robot or DEFAULT
                if live.ros is not None:
                    of_model = calibration if not files.robot else None
                    robot = of_model.machine if of_model else options.get_robot(name)
                    arm = stack.enter_context(live.over_ros(robot, live.truth))
                else:
                    how = {"parameters": twin or "nominal", "seed": seed or 0}
                    backend = truejoint.crtk.PacedBackend(options.make_twin(name, **how))
                    arm = stack.enter_context(truejoint.crtk.Arm(backend))
                page = truejoint.monitor.ArmPage(
                    arm, calibration, host=host, port=port, remote_control=remote_control
                )
            url = stack.enter_context(page).url
            out.print(f"Open {url} in a browser; Ctrl-C ends.")
            if recording is None and live.ros is None:
                _move(arm, motions)
            _wait()
    except KeyboardInterrupt:
        say("stopped")


def _move(arm: truejoint.crtk.Arm, motions: list[truejoint.motion.Trajectory] | None) -> None:
    """Home a simulated arm and move it along trajectories, else at random until Ctrl-C."""
    say(f"Homing {arm.robot.title}, simulated in real time ...")
    random_motion = truejoint.motion.random_motion
    endless = (random_motion(arm.robot, _PIECE, seed) for seed in itertools.count())
    try:
        arm.enable()
        arm.home()
        for motion in motions or endless:
            truejoint.motion.follow(arm, motion, resume_within=_DAY)
    except TruejointError as error:
        say(str(error))  # the page shows where it stands


def _wait() -> None:
    threading.Event().wait()
