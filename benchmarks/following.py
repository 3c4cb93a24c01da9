"""How far an arm's reported positions are from a trajectory, and how much faster than real time.

    python -m benchmarks.following [--minutes 17] [--seeds 0 1 2]

Simulated arms follow a zig-zag of J2-J3 (sparsity 1/4) and two minutes of random motion at the
paper's speeds: with the trajectory as their set-points, and with a loop around what they report
(`truejoint.runtime.motor_loop`). Errors are where joints are wanted at a moment minus where they
are reported at that moment: RMS, and the largest in brackets, in the worst of the seeds. Then a
collection of a random motion, recorded, in either way.
"""

from __future__ import annotations

import argparse
import os
import time

import numpy as np

import truejoint
from truejoint.crtk import Arm, SimulatedBackend, StateBlock, TruthBlock
from truejoint.motion import Trajectory, follow, nominal_duration, random_motion, zigzag
from truejoint.runtime import motor_loop
from truejoint.simulation import make_twin
from truejoint.units import display_unit


def arm_of(seed: int, rate: float) -> Arm:
    """Homed arm."""
    arm = Arm(SimulatedBackend(make_twin("raven2", seed=seed), rate=rate))
    arm.enable()
    arm.home()
    return arm


def error(path: Trajectory, seed: int, rate: float, *, looped: bool) -> np.ndarray:
    """RMS and largest size (2, n_joints) [rad or m] of what is wanted minus what is reported."""
    arm, blocks = arm_of(seed, rate), []

    def keep(block: StateBlock | TruthBlock) -> None:
        if isinstance(block, StateBlock):
            blocks.append(block)

    arm.subscribe(keep, every=1.0)
    follow(arm, path, steering=motor_loop(arm.robot) if looped else None)
    arm.unsubscribe(keep)
    columns = [arm.robot.channels.index(name) for name in path.joints]
    state = StateBlock.joined(blocks)
    law = path.time_law(arm.robot.workspace.speed)
    count = round(np.ceil(nominal_duration(path, arm.robot) * rate - 1e-6))
    wanted = law.at(np.arange(1, count + 1) / rate)
    missed = wanted - state.measured[-count:, columns]
    return np.array([np.sqrt((missed**2).mean(axis=0)), np.abs(missed).max(axis=0)])


def collected(minutes: float, *, looped: bool) -> str:
    """How long a collection of so much random motion takes."""
    arm, began = arm_of(0, 500.0), time.monotonic()
    motion = random_motion(arm.robot, 60.0 * minutes, seed=3)
    with truejoint.recordings.Recorder(arm) as recorder:
        report = follow(arm, motion, steering=motor_loop(arm.robot) if looped else None)
    recorder.recording()
    return f"{report.duration / 60:.1f} min, recorded: {time.monotonic() - began:.1f} s; {report}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=17.0)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    options = parser.parse_args()
    robot = truejoint.get_robot("raven2")
    print("| trajectory | set-points [Hz] | loop | shoulder [deg] | elbow [deg] | insertion [mm] |")
    print("| :--- | ---: | :--- | ---: | ---: | ---: |", flush=True)
    for path in (zigzag(robot, "J2-J3", 1 / 4), random_motion(robot, 120.0, seed=7)):
        scales = [display_unit(unit).scale for unit in path.units]
        for rate, looped in ((1000.0, False), (500.0, False), (500.0, True)):
            worst = np.max([error(path, s, rate, looped=looped) for s in options.seeds], axis=0)
            cells = " | ".join(f"{rms:.3f} ({most:.2f})" for rms, most in (worst * scales).T)
            print(f"| {path.name} | {rate:g} | {'yes' if looped else 'no'} | {cells} |", flush=True)
    print()
    for looped in (False, True):
        print(collected(options.minutes, looped=looped), flush=True)
    print(f"load {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main()
