"""How fast two compiled twins run on one core at their full 1 kHz, and how exactly the wrist's.

    python -m benchmarks.twin_speed

Compiles first; prints how many times faster than real time a twin is, the median and the range over
blocks of 10 s of simulated motion. Then, for each specimen of the wrist and each law of friction,
how far 20 s of multi-sines with pushes of 1.5 N at the tip are off at 4 kHz from what they are at
32 kHz: RMS of every joint in deg.
"""

from __future__ import annotations

import time

import numpy as np

from truejoint.simulation import make_twin
from truejoint.simulation.wrist.parameters import SUBSTEPS, WristParameters
from truejoint.simulation.wrist.twin import WristTwin
from truejoint.studies.wrist import motions

BLOCK = 10.0  # s of simulated time
BLOCKS = 60
AMPLITUDES = {
    "raven2": np.array([np.radians(8.0), np.radians(10.0), 0.02]),
    "wrist": np.radians([30.0, 8.0, 8.0]),
}
FINEST = 32  # steps in a millisecond
PUSH = 1.5  # [N]


def speed(robot: str) -> None:
    """Time a twin and print one line."""
    twin = make_twin(robot)
    twin.home()
    t = np.arange(round(BLOCK * 1000)) * 1e-3
    goal = np.tile(twin.robot.home, (len(t), 1))
    goal[:, :3] += AMPLITUDES[robot] * np.sin(2 * np.pi * t[:, None] / BLOCK)
    twin.run(goal)
    factors = []
    for _ in range(BLOCKS):
        start = time.process_time()  # other programs on the machine do not count
        twin.run(goal)
        factors.append(BLOCK / (time.process_time() - start))
    print(
        f"{robot} twin, 1 kHz: {np.median(factors):.0f} times real time "
        f"({min(factors):.0f} to {max(factors):.0f} over {BLOCKS} blocks of {BLOCK:g} s)"
    )


def exactness(specimen: str, law: str) -> None:
    """Print how far a specimen's joints are off those of an eight times finer step."""
    parameters = WristParameters.read(specimen).with_values({"joint_friction.law": law})
    path = motions.joints(motions.multi_sine(20.0, 1))
    found = []
    for substeps in (SUBSTEPS, FINEST):
        twin = WristTwin(parameters, substeps=substeps)
        twin.home()
        twin.run(np.linspace(twin.commanded, path[0], 1500))
        twin.tip_force = lambda t: PUSH * np.sin(np.outer(t, [2.0, 3.0]))
        found.append(twin.run(path).joint)
    off = np.degrees(np.sqrt(np.mean((found[0] - found[1]) ** 2, axis=0)))
    print(f"wrist {specimen}, {law}: " + " ".join(f"{value:.4f}" for value in off))


def main() -> None:
    """Print speed and exactness."""
    for robot in AMPLITUDES:
        speed(robot)
    for specimen in WristParameters.SPECIMENS:
        for law in ("dahl", "maxwell_slip"):
            exactness(specimen, law)


if __name__ == "__main__":
    main()
