"""How soon an arm stands that is asked to pause, whatever it is doing, by another thread.

    python -m benchmarks.stopping [--pauses 1000] [--seed 0]

A thread asks for a pause at a random moment of a random command of the simulated RAVEN-II: homing,
moves in joint space and in space, a stream, waiting, following a trajectory; in pieces of 10 ms
where it listens to each, else of up to 0.5 s. What counts is the
robot's clock from the first state message after the asking until the last one. `allowed` is 20 ms
and the braking; a miss is a pause that took longer, a set-point that did not come to rest, an arm
that is not PAUSED, or a command that did not say that it was stopped.
"""

from __future__ import annotations

import argparse
import threading
from collections.abc import Callable

import numpy as np

from truejoint.crtk import Arm, StateBlock, TruthBlock, simulated_arm
from truejoint.crtk.arm import BRAKING
from truejoint.errors import CommandRefused
from truejoint.motion import follow, zigzag

ALLOWED = 0.02 + BRAKING
LATEST = 4.0  # of the robot's clock [s] after a command began
SLOW = np.array([0.005, 0.005, 0.001, 0.02, 0.02, 0.02, 0.02])  # [rad/s, m/s]


def commands(arm: Arm, rng: np.random.Generator) -> dict[str, Callable[[], object]]:
    """Every kind of command, none over within a minute: a thread is not woken at once."""
    home = arm.robot.home
    way = 0.5 * rng.choice([-1.0, 1.0], 7) * np.array([0.5, 0.5, 0.1, 1.0, 1.0, 0.5, 0.5])
    rows = home + np.linspace(0.0, 0.5, 60_000)[:, None] * way

    def move_cp() -> None:
        pose = arm.setpoint_cp()
        pose[:3, 3] += rng.choice([-1.0, 1.0], 3) * [0.01, 0.008, 0.01]
        arm.move_cp(pose, 0.1 * SLOW).wait()

    return {
        "home": arm.home,
        "move_jp": lambda: arm.move_jp(home + way, SLOW).wait(),
        "move_jr": lambda: arm.move_jr(way, SLOW).wait(),
        "move_cp": move_cp,
        "servo_jp_stream": lambda: arm.servo_jp_stream(rows),
        "wait": lambda: arm.wait(60.0),
        "follow": lambda: follow(arm, zigzag(arm.robot, "J1-J2-J3", 1 / 2)),
    }


def one(
    arm: Arm, name: str, call: Callable[[], object], delay: float, every: float
) -> tuple[float, bool]:
    """Time until the arm stood [s], and whether all is as it should be."""
    start, due, asked = arm.time, threading.Event(), []

    def look(_: StateBlock | TruthBlock) -> None:
        if arm.time >= start + delay:
            due.set()

    def pause() -> None:
        while name == "home" and arm.time < start + delay:  # reports nothing
            pass
        due.wait(60.0) if name != "home" else None
        asked.append(arm.time)
        arm.pause()

    arm.subscribe(look, every)
    thread = threading.Thread(target=pause)
    thread.start()
    said = False
    try:
        call()
    except CommandRefused:  # stopped, or not begun where the pause came while it was planned
        said = True
    thread.join(60.0)
    arm.unsubscribe(look)
    took = arm.time - asked[0]
    rests = name == "home" or not arm.setpoint_js(np.inf).velocity.any()
    return took, said and rests and arm.operating_state().state == "PAUSED"


def main() -> None:
    """Pause again and again, and count what went wrong."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pauses", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    arm = simulated_arm(seed=options.seed)
    arm.enable()
    arm.home()
    names = list(commands(arm, rng))
    times: dict[str, list[float]] = {name: [] for name in names}
    misses = dict.fromkeys(names, 0)
    for _ in range(options.pauses):
        name = names[rng.integers(len(names))]
        delay, every = float(rng.uniform(0.0, LATEST)), float(rng.choice([0.0, 0.5]))
        took, good = one(arm, name, commands(arm, rng)[name], delay, every)
        times[name].append(took)
        misses[name] += not good or took > ALLOWED + 1e-9
        arm.resume()
        if not arm.operating_state().is_homed:
            arm.home()
        arm.move_jp(arm.robot.home, np.full(7, 0.04)).wait()
    print("| command | pauses | median [ms] | longest [ms] | allowed [ms] | misses |")
    print("| :--- | ---: | ---: | ---: | ---: | ---: |")
    for name in names:
        if times[name]:
            median, longest = 1e3 * np.median(times[name]), 1e3 * max(times[name])
            row = f"{median:.0f} | {longest:.0f} | {1e3 * ALLOWED:.0f} | {misses[name]}"
            print(f"| {name} | {len(times[name])} | {row} |")


if __name__ == "__main__":
    main()
