"""`check` and `rezero` look at a twin that another process serves: over ROS 1 as over ROS 2."""

import os
import shlex
import subprocess
import sys

import numpy as np
import pytest
from tests.cli.conftest import Call, Result
from tests.ros_master import Master, environment, free_port, needs_ros

import truejoint
from truejoint.crtk import simulated_arm
from truejoint.motion import Trajectory, follow, random_motion
from truejoint.recordings import Recorder

LONG = 60.0  # [s], on a busy machine
SEED = 3
PATIENT = f"""
import truejoint.crtk.arm, truejoint.crtk.backends.ros as ros
ros.SILENCE = ros.CONNECT_TIMEOUT = truejoint.crtk.arm.SILENCE = {LONG}
from truejoint.cli.app import main
main()
"""


class CallElsewhere(Call):
    """Runs the command in a process of its own: rospy knows one master in a process."""

    def __call__(self, *words):
        command = [sys.executable, "-c", PATIENT, *shlex.split(words[0])]
        done = subprocess.run(command, capture_output=True, text=True, check=False)  # noqa: S603
        return Result(done.returncode, done.stdout, done.stderr)


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    """Offsets of the same twin, none of which is right at its home pose."""
    with simulated_arm("dvrk_psm", "psm1", seed=SEED) as arm:
        arm.enable()
        arm.home()
        with Recorder(arm) as recorder:
            follow(arm, random_motion(arm.robot, 20.0, seed=1))
    path = tmp_path_factory.mktemp("model") / "m.safetensors"
    made = truejoint.calibrate(recorder.recording(), "offset")
    truejoint.write_calibration(made, path.with_name("made.safetensors"))
    truejoint.write_calibration(made.at(truejoint.calibration.Zero(np.full(6, 0.02))), path)
    return path


@pytest.fixture(scope="module")
def at_home(model):
    """Truth less corrected position at rest, of the twin in this process."""
    with simulated_arm("dvrk_psm", "psm1", seed=SEED) as arm:
        arm.enable()
        arm.home()
        here = arm.robot.home[0]
        with Recorder(arm) as recorder:
            follow(arm, Trajectory(("outer_yaw",), ("rad",), np.array([[here], [here + 1e-4]])))
    rest = recorder.recording().with_truth(arm.robot.positioning)
    calibration = truejoint.read_calibration(model)
    return np.median(rest.columns("truth", calibration.joints) - calibration.correct(rest), axis=0)


@pytest.fixture(params=[pytest.param("1", marks=needs_ros), "2"])
def ros(request, tmp_path, monkeypatch):
    """Number of the ROS on which another process serves the twin."""
    port = free_port()
    for name, value in {
        **environment(port, tmp_path), "ROS_DOMAIN_ID": str(2 + os.getpid() % 100),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    }.items():  # fmt: skip
        monkeypatch.setenv(name, value)
    words = f"--robot dvrk_psm:psm1 --homed --seed {SEED} --state-rate-hz 100 --ros {request.param}"
    command = [sys.executable, "-m", "truejoint", "node", "simulate", *words.split()]

    def served():
        with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:  # noqa: S603
            try:
                assert any("/PSM1/measured_js" in line for line in process.stderr)
                yield request.param
            finally:
                process.terminate()
                process.communicate()

    if request.param == "2":
        yield from served()
    else:
        with Master(port, tmp_path):
            yield from served()


def test_a_served_arm_is_checked_and_its_model_re_zeroed(call, ros, model, at_home):
    call = CallElsewhere(call.patch, call.capture)
    brief = f"{model} --ros {ros} --duration-s 1 --truth /ext_jpos"
    offsets = [joint["offset"] for joint in call.json(f"check {brief}")["joints"]]
    # Its wrist gives way by some hundredths of a degree after the homing.
    near = [np.radians(0.2), np.radians(0.2), 1e-3, *3 * [np.radians(1.0)]]
    np.testing.assert_array_less(np.abs(offsets - at_home), near)
    call.good(f"rezero {brief} -o today.safetensors")
    today = truejoint.read_calibration("today.safetensors")
    np.testing.assert_array_less(np.abs(today.zero.offset - offsets), near)
    words = f"{model.with_name('made.safetensors')} --ros {ros} --duration-s 1 --potentiometers"
    call.refuses("outer_insertion hardly moved", f"rezero {words} -o p.safetensors")
    said = "/ext_jpoz: no truth is published there; did you mean '/ext_jpos'?"
    call.refuses(said, f"check {model} --ros {ros} --duration-s 1 --truth /ext_jpoz")
