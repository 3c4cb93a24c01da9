"""`check` and `rezero` look at a twin that another process serves over ROS 2.

`tests/test_lab_day.py` re-zeroes over ROS 1.
"""

import os
import subprocess
import sys

import numpy as np
import pytest

import truejoint
from truejoint.crtk import simulated_arm
from truejoint.crtk.backends import ros as backends
from truejoint.crtk.ros import state_stream
from truejoint.motion import Trajectory, follow, random_motion
from truejoint.recordings import Recorder

LONG = 60.0  # [s], on a busy machine
SEED = 3
# Wandering friction would let the wrist give way while a busy machine starts what looks at it.
STILL = "[motor_friction]\nwander = 0.0\nwarm_up = 0.0\n"


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    """Offsets of the same twin, none right at its home pose, and what they leave there at rest."""
    path = tmp_path_factory.mktemp("model") / "m.safetensors"
    still = path.with_name("still.toml")
    still.write_text(STILL)
    with simulated_arm("dvrk_psm", "psm1", parameters=still, seed=SEED) as arm:
        arm.enable()
        arm.home()
        here, recordings = arm.robot.home[0], []
        rest = Trajectory(("outer_yaw",), ("rad",), np.array([[here], [here + 1e-4]]))
        for motion in (rest, random_motion(arm.robot, 20.0, seed=1)):
            with Recorder(arm) as recorder:
                follow(arm, motion)
            recordings.append(recorder.recording())
    at_rest = recordings[0].with_truth(arm.robot.positioning)
    made = truejoint.calibrate(recordings[1], "offset")
    truejoint.write_calibration(made, path.with_name("made.safetensors"))
    off = made.at(truejoint.calibration.Zero(np.full(6, 0.02)))
    truejoint.write_calibration(off, path)
    left = at_rest.columns("truth", off.joints) - off.correct(at_rest)
    return path, np.median(left, axis=0)


@pytest.fixture
def served(model, monkeypatch):
    """The twin, while another process serves it."""
    for place in (backends, sys.modules["truejoint.crtk.arm"], state_stream):
        monkeypatch.setattr(place, "SILENCE", LONG)
    monkeypatch.setattr(backends, "CONNECT_TIMEOUT", LONG)
    monkeypatch.setenv("ROS_DOMAIN_ID", str(2 + os.getpid() % 100))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    words = f"--robot dvrk_psm:psm1 --homed --seed {SEED} --state-rate-hz 100 --ros 2 --twin"
    command = [sys.executable, "-m", "truejoint", "node", "simulate", *words.split()]
    command.append(model[0].with_name("still.toml"))
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:  # noqa: S603
        try:
            assert any("/PSM1/measured_js" in line for line in process.stderr)
            yield
        finally:
            process.terminate()
            process.communicate()


@pytest.mark.usefixtures("served")
def test_a_served_arm_is_checked_and_its_model_re_zeroed(call, model):
    path, at_home = model
    link = "--ros 2 --duration-s 1"
    brief = f"{path} {link} --truth /ext_jpos"
    offsets = [joint["offset"] for joint in call.json(f"check {brief}")["joints"]]
    near = np.where(np.arange(6) == 2, 1e-3, np.radians(0.2))
    np.testing.assert_array_less(np.abs(offsets - at_home), near)
    call.good(f"rezero {brief} -o today.safetensors")
    today = truejoint.read_calibration("today.safetensors")
    np.testing.assert_array_less(np.abs(today.zero.offset - offsets), near)
    words = f"{path.with_name('made.safetensors')} {link} --potentiometers -o p.safetensors"
    call.refuses("outer_insertion hardly moved", f"rezero {words}")
    said = "/ext_jpoz: no truth is published there; did you mean '/ext_jpos'?"
    call.refuses(said, f"check {path} {link} --truth /ext_jpoz")
