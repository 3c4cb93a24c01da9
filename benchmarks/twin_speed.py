"""How many times faster than real time the RAVEN-II twin runs, on one core at its full 1 kHz.

Run with ``python benchmarks/twin_speed.py``; compiles first, and prints the median and the range
over blocks of 10 s of simulated motion.
"""

from __future__ import annotations

import time

import numpy as np

from truejoint.simulation.raven2 import Raven2Twin

BLOCK = 10.0  # s of simulated time
BLOCKS = 60


def main() -> None:
    """Time the twin and print one line."""
    twin = Raven2Twin(seed=0)
    twin.home()
    t = np.arange(round(BLOCK * 1000)) * 1e-3
    goal = np.tile(twin.robot.home, (len(t), 1))
    amplitude = np.array([np.radians(8.0), np.radians(10.0), 0.02])
    goal[:, :3] += amplitude * np.sin(2 * np.pi * t[:, None] / BLOCK)
    twin.run(goal)
    factors = []
    for _ in range(BLOCKS):
        start = time.process_time()  # other programs on the machine do not count
        twin.run(goal)
        factors.append(BLOCK / (time.process_time() - start))
    print(
        f"RAVEN-II twin, 1 kHz: {np.median(factors):.0f} times real time "
        f"({min(factors):.0f} to {max(factors):.0f} over {BLOCKS} blocks of {BLOCK:g} s)"
    )


if __name__ == "__main__":
    main()
