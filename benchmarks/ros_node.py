"""How well `truejoint node correct` keeps up with joint states at 1 kHz, over a real ROS 1 master.

    python -m benchmarks.ros_node [--seconds 600] [--rate 1000]

A RAVEN-II's joint states, from the twin following a zig-zag, are published at the rate; the node
runs in a process of its own, with a linear calibration. `added` is the time from the arrival of a
joint state at a subscriber to that of the corrected one at the same: what a client that changes to
the corrected topic has to wait longer. `core` is the node's processor time over the time that
passed; `load` is what the machine was busy with, all programs together, divided by its cores.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from tests.ros_master import Master, environment, free_port

import truejoint
from truejoint.crtk import Arm, SimulatedBackend
from truejoint.crtk.messages import JOINT_STATE, OPERATING_STATE
from truejoint.crtk.ros import open_transport
from truejoint.motion import follow, zigzag

FASTER = 8.0  # than the workspace's speeds, to have the whole zig-zag in half a minute
RAW, CORRECTED = "/arm1/measured_js", "/arm1/corrected/measured_js"


def session(order: str = "J2", faster: float = FASTER, rate: float = 1000.0) -> truejoint.Recording:
    """Record a zig-zag of the twin, `rate` times a second."""
    arm = Arm(SimulatedBackend(truejoint.simulation.make_twin("raven2", seed=3)))
    arm.enable()
    arm.home()
    speed = faster * truejoint.motion.workspace_of(arm.robot).speed
    with truejoint.recordings.Recorder(arm, state_rate=rate) as recorder:
        follow(arm, zigzag(arm.robot, order, 1 / 2), speed=speed)
    return recorder.recording()


def run(folder: Path, seconds: float, rate: float) -> None:
    """Publish, listen and print."""
    recording = session()
    robot = recording.robot
    model = truejoint.calibrate(recording, "linear")
    truejoint.write_calibration(model, folder / "model.safetensors")
    position = recording.columns("measured", robot.joint_names)
    effort = recording.columns("effort", robot.joint_names)
    effort = robot.transmission.joint_effort(effort)  # type: ignore[union-attr]  # RAVEN's
    there = np.r_[np.arange(len(position)), np.arange(len(position))[::-1]]  # and back, for ever

    ros = open_transport(1, "benchmark")
    joints, states = (
        ros.publisher(RAW, JOINT_STATE),
        ros.publisher("/arm1/operating_state", OPERATING_STATE),
    )
    arrived: dict[str, dict[float, float]] = {RAW: {}, CORRECTED: {}}
    for topic, times in arrived.items():
        ros.subscribe(
            topic, JOINT_STATE,
            lambda message, times=times: times.__setitem__(
                ros.seconds(message), time.perf_counter()
            ),
        )  # fmt: skip
    command = [sys.executable, "-m", "truejoint", "node", "correct",
               str(folder / "model.safetensors"), "--profile", "raven2_mended"]  # fmt: skip
    node = subprocess.Popen(command)  # our own
    while joints.readers < 2 or states.readers < 1:
        time.sleep(0.01)
        if node.poll() is not None:
            raise SystemExit("the node did not start")
    state = ros.stamped(OPERATING_STATE, ros.now())
    state.state, state.is_homed = "ENABLED", True
    states.publish(state)
    time.sleep(1.0)

    sent, began, busy = [], time.perf_counter(), _busy(node.pid)
    everything = _everything()
    for k in range(round(seconds * rate)):
        due = began + k / rate
        while (left := due - time.perf_counter()) > 0.0:
            time.sleep(left)
        row = there[k % len(there)]
        message = ros.stamped(JOINT_STATE, 1e9 + k / rate)
        message.position, message.effort = position[row].tolist(), effort[row].tolist()
        sent.append(ros.seconds(message))
        joints.publish(message)
    passed = time.perf_counter() - began
    core = (_busy(node.pid) - busy) / passed
    load = (_everything() - everything) / passed / (os.cpu_count() or 1)
    time.sleep(1.0)
    node.send_signal(signal.SIGTERM)
    node.wait()
    raw, corrected = arrived[RAW], arrived[CORRECTED]
    lost = sum(stamp not in corrected for stamp in sent)
    added = np.array([corrected[s] - raw[s] for s in sent if s in corrected and s in raw])
    median, p99, worst = np.quantile(added, [0.5, 0.99, 1.0]) * 1e3
    print("| sent | rate [Hz] | lost | added: median [ms] | p99 [ms] | worst [ms] | core | load |")
    print("| ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |")
    print(
        f"| {len(sent)} | {len(sent) / passed:.0f} | {lost} | {median:.2f} | {p99:.2f} | "
        f"{worst:.1f} | {core:.0%} | {load:.0%} |"
    )


def _busy(pid: int) -> float:
    """Processor time of a process [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _everything() -> float:
    """Processor time of all programs [s], over all cores."""
    fields = [int(f) for f in Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:]]
    return (sum(fields[:3]) + sum(fields[5:8])) / os.sysconf("SC_CLK_TCK")


def main() -> None:
    """Run a master of our own, on this computer alone."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--rate", type=float, default=1000.0)
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        port = free_port()
        os.environ.update(environment(port, Path(folder)))
        with Master(port, Path(folder)):
            run(Path(folder), chosen.seconds, chosen.rate)


if __name__ == "__main__":
    main()
